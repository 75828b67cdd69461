"""Which stretch of a stream belongs to each commanded target: still, settled, and long enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.streams.campaign import DroppedPose
from kincal.identification.streams.commands import Holds
from kincal.identification.streams.stillness import Bins
from kincal.urdf.description import Log
from kincal.urdf.rigid_motion import wrap

_MOST = 0.9  # of the moves that are seen: one pose that is long restless says nothing of the others
_DRIFT = 5.0  # standard errors of a stretch's drift


@dataclass(frozen=True)
class Window:
    """begin <= t < end [s], on the stream's clock, of the target in row `row` of the holds."""

    row: int
    pose: int
    begin: float
    end: float


def still_windows(bins: Bins, holds: Holds, offset: float, log: Log) -> tuple[list[Window], list[DroppedPose]]:
    """The stretch of each target, in order of time; and the targets that have none, with the reason.

    A stretch begins settle_seconds after the sensor came to rest, and ends where the next command came. A motion that
    the sensor can't see (about gravity, without a gyro) is given as long as nine in ten of those take that it sees.
    """
    moving = bins.moving()
    begin, end = holds.begin + offset, holds.end + offset
    runs = [_longest_run(bins, moving, b, e) for b, e in zip(begin, end, strict=True)]
    travels = [bins.start[r[0]] - b for r, b in zip(runs, begin, strict=True) if r and r[2]]
    usual = float(np.quantile(travels, _MOST)) if travels else 0.0
    number, times = np.unique(holds.pose, return_counts=True)
    repeated = set(number[times > 1].tolist())
    windows, dropped = [], [DroppedPose(pose, "more than one target has its number") for pose in sorted(repeated)]
    for row, (pose, run, b, e) in enumerate(zip(holds.pose.tolist(), runs, begin, end, strict=True)):
        if pose in repeated:
            continue
        window = _window(bins, run, b, e, usual, log)
        if isinstance(window, str):
            dropped.append(DroppedPose(pose, window))
        else:
            windows.append(Window(row, pose, *window))
    return windows, dropped


def _longest_run(bins: Bins, moving: np.ndarray, begin: float, end: float) -> tuple[int, int, bool] | None:
    """First and last but one still bin within a target's time, and whether motion was seen before; None: no sample."""
    low, high = np.searchsorted(bins.start, begin), np.searchsorted(bins.start, end - bins.width, side="right")
    if high <= low:
        return None
    flags = np.concatenate([[True], moving[low:high], [True]])
    edges = np.flatnonzero(flags[1:] != flags[:-1]).reshape(-1, 2)
    if not len(edges):
        return int(low), int(low), True
    k = np.argmax(edges[:, 1] - edges[:, 0])
    return int(low + edges[k, 0]), int(low + edges[k, 1]), bool(edges[k, 0] > 0)


def _window(
    bins: Bins, run: tuple[int, int, bool] | None, begin: float, end: float, travel: float, log: Log
) -> tuple[float, float] | str:
    """Begin and end [s] of a stretch, or why there is none."""
    if run is None:
        return "the stream has no samples then"
    first, beyond, seen = run
    needed = log.min_seconds
    held = min(end, bins.start[-1] + bins.width) - begin
    if held < needed + log.settle_seconds:
        return f"held for {held:.1f} s; allowed are at least {needed + log.settle_seconds:g} s, settling included"
    if beyond <= first:
        return f"still moving for all of its {held:.1f} s"
    since = (bins.start[first] if seen else max(begin + travel, bins.start[0])) + log.settle_seconds
    until = min(bins.start[beyond - 1], end - bins.width, since + log.max_seconds)
    if until - since < needed:
        still = max(until - since, 0.0)
        return f"still moving: settled for {still:.1f} s of {held:.1f} s; allowed are at least {needed:g} s"
    drift = _drift(bins, since, until)
    if drift is not None:
        return f"still moving: it drifts by {np.rad2deg(drift):.2g} degrees in {until - since:.1f} s"
    return float(since), float(until)


def _drift(bins: Bins, begin: float, end: float) -> float | None:
    """[rad] how far roll or pitch drifts over a stretch, where that is no chance and more than a sample's noise."""
    low, high = np.searchsorted(bins.start, [begin, end])
    if high - low < 4:
        return None
    t = bins.start[low:high] - bins.start[low:high].mean()
    angles = bins.medians[low:high, :2].astype(float)
    angles = wrap(angles - angles[0])
    slope = t @ (angles - angles.mean(axis=0)) / (t @ t)
    left = angles - angles.mean(axis=0) - np.outer(t, slope)
    error = np.sqrt((left**2).sum(axis=0) / (len(t) - 2) / (t @ t))
    drift = np.abs(slope) * (end - begin)
    bad = (np.abs(slope) > _DRIFT * error) & (drift > bins.noise[:2])
    return float(drift[bad].max()) if bad.any() else None
