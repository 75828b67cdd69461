"""A stream and a command log -> the stretches of each commanded pose in which the sensor was still."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.streams.campaign import Campaign, ClockOffset, DroppedPose
from kincal.identification.streams.clock_offset import estimate_offset
from kincal.identification.streams.columns import ANGLES, OPTIONAL
from kincal.identification.streams.commands import read_commands
from kincal.identification.streams.reading import complete, open_stream
from kincal.identification.streams.repeats import STUCK
from kincal.identification.streams.stillness import binned
from kincal.identification.streams.windows import Window, still_windows
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.input_files import kept

_LEAST = 5  # samples a pose


@dataclass(frozen=True)
class StaticPoses:
    """What a log gives: one row a kept pose, their samples, and what was left out."""

    table: pd.DataFrame  # pose, and the joints' readings as commanded
    stream: pd.DataFrame  # t [s], pose, angles [rad] and further channels: the still samples of the kept poses
    campaign: Campaign


def static_poses(measure: Measure, joints: Sequence[str]) -> StaticPoses:
    """The poses of measure.streams and measure.commands. The stream is read twice: to find the stretches, to take them.

    Raises InputError as the readers do, and where no pose is left.
    """
    assert measure.streams is not None
    assert measure.commands is not None
    log, file = measure.log, measure.streams
    holds = read_commands(measure.commands, joints, measure)
    stream = open_stream(file, measure)
    bins = binned(stream, file)
    offset = estimate_offset(bins, holds, file) if log.offset_seconds is None else ClockOffset(log.offset_seconds)
    windows, dropped = still_windows(bins, holds, offset.seconds, log)
    samples = _telling(_within(file, stream, windows), measure)
    dropped += _unusable(samples, [w.pose for w in windows])
    bad = {d.pose for d in dropped}
    rows = [w.row for w in windows if w.pose not in bad]
    if not rows:
        reasons = "; ".join(f"pose {d.pose}: {d.reason}" for d in dropped[:3])
        raise InputError(f"{file}: none of {len(holds)} commanded poses is left: {reasons}")
    table = pd.DataFrame({"pose": holds.pose[rows]} | {n: holds.joints[rows, k] for k, n in enumerate(joints)})
    used = samples.loc[~np.isin(samples["pose"], sorted(bad))].reset_index(drop=True)
    left_out = tuple(sorted(dropped, key=lambda d: d.pose))
    return StaticPoses(table, used, Campaign(stream.health, offset, len(holds), len(table), left_out))


def _within(file: Path, chunks: Iterable[pd.DataFrame], windows: list[Window]) -> pd.DataFrame:
    """The samples inside the windows, with their pose."""
    begin, end, pose = (np.array([getattr(w, name) for w in windows]) for name in ("begin", "end", "pose"))

    def inside(chunk: pd.DataFrame) -> pd.DataFrame:
        t = chunk["t"].to_numpy(float)
        k = np.searchsorted(begin, t, side="right") - 1
        good = (k >= 0) & (t < np.append(end, -np.inf)[k])
        part = chunk[good].copy()
        part.insert(1, "pose", pose[k[good]])
        return part

    parts = [part for part in kept(file, map(inside, chunks)) if len(part)]
    return complete(pd.concat(parts)) if parts else pd.DataFrame({"t": [], "pose": []})


def _telling(samples: pd.DataFrame, measure: Measure) -> pd.DataFrame:
    """Without optional channels that in most poses don't change: no instrument is behind them (a heading of 0), or its
    resolution hides its noise; and without a yaw that is not wanted (measure.channels)."""
    optional = [name for name in samples if name in OPTIONAL]
    values = samples.groupby("pose")[optional].nunique()
    gone = [name for name in optional if np.mean(values[name] == 1) > 0.5]
    if "yaw" in optional and measure.channels is not None and "yaw" not in measure.channels:
        gone.append("yaw")
    return samples.drop(columns=gone)


def _unusable(samples: pd.DataFrame, poses: list[int]) -> list[DroppedPose]:
    """Poses with too few samples, and those in which a channel is stuck."""
    pose, count = np.unique(samples["pose"], return_counts=True)
    counts = dict(zip(pose.tolist(), count.tolist(), strict=True))
    dropped = {
        p: f"{counts.get(p, 0)} good samples; allowed are at least {_LEAST}" for p in poses if counts.get(p, 0) < _LEAST
    }
    values = samples.groupby("pose")[[c for c in ANGLES if c in samples]].nunique()
    for channel in values:
        for p in pose[(np.asarray(values[channel]) == 1) & (count >= STUCK)].tolist():
            dropped[p] = f"channel {quoted(channel)} is stuck for all {counts[p]} samples"
    return [DroppedPose(p, reason) for p, reason in dropped.items()]
