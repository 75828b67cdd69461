"""Streams that say of each sample which pose it is of: order of time, and stuck channels, pose by pose.

Time matters within a pose alone: poses may come in any order, each with a clock of its own. Within one, time is judged
as in a log, but a time may come again: a clock coarser than the sampling. Only a record that repeats the one before in
all it says was written twice.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from kincal.identification.streams.health import Tally
from kincal.identification.streams.repeats import STUCK
from kincal.identification.streams.timeline import GAP, STEP, Timeline


def whole_numbers(pose: np.ndarray) -> np.ndarray:
    """(n,) which of them can be a pose's number."""
    return np.isfinite(pose) & (pose == np.round(pose))


def in_order(samples: pd.DataFrame, tally: Tally) -> pd.DataFrame:
    """Without the samples that run back in time within their pose, or come twice; t is shifted where a clock was set.

    samples: t [s], pose and channels, all finite but for optional channels, with a plain range as index.
    """
    t, pose = samples["t"].to_numpy(float), samples["pose"].to_numpy(float)
    order = np.argsort(pose, kind="stable")
    within, steps = np.diff(pose[order]) == 0, np.diff(t[order])
    forward = steps[within & (steps > 0)]
    interval = float(np.median(forward)) if len(forward) else None
    odd = within & ((steps < 0) | (steps > (np.inf if interval is None else GAP * interval)))
    troubled = np.isin(pose, pose[order][1:][odd])
    parts = [samples.loc[~troubled]]
    for _, group in samples.loc[troubled].groupby("pose"):
        beyond = int(group.index[-1]) + 1
        timeline = Timeline(tally, interval, repeating=True)
        parts.append(timeline.feed(group, final=True, following=float(t[beyond]) if beyond < len(t) else None))
    found: pd.DataFrame = pd.concat(parts).sort_index()
    as_read = t[found.index]
    tally.clock_steps += int(np.sum((np.diff(found["pose"]) != 0) & (np.diff(as_read) <= -STEP)))
    return _once(found, tally)


def _once(samples: pd.DataFrame, tally: Tally) -> pd.DataFrame:
    values = samples.to_numpy(float)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    again = np.concatenate([np.zeros(min(len(values), 1), dtype=bool), same.all(axis=1)])
    tally.repeated += int(again.sum())
    return samples.loc[~again].reset_index(drop=True)


def not_revisited(stuck: np.ndarray, values: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(n,) the stuck samples whose value their pose has at no other time.

    A held pose may sit in the midst of a coarse channel's step: long runs of one value, which comes back again.
    """
    if not stuck.any():
        return stuck
    at = pd.MultiIndex.from_arrays([pose, values])
    return stuck & ~at.isin(at[~stuck])


def all_of_pose(frozen: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(n,) which frozen samples are of poses with no others: such a pose is left out as a whole, with that reason."""
    _, of, counts = np.unique(pose, return_inverse=True, return_counts=True)
    lost = np.bincount(of, frozen, len(counts)) == counts
    return frozen & (lost & (counts >= STUCK))[of]
