"""By how much a sensor's clock is ahead of the command log's: a constant, found from the motions that both know.

Onsets of motion in the stream are paired with the commands' changes of target, all with all: the lags that many pairs
share are the candidates. With poses at equal intervals several fit; the right one is that at which the angles before
each change follow from the joint values (a plane, fitted), since a wrong one pairs them with other poses' joints. Where
that fits several alike, the one that explains most motions is taken.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kincal.identification.streams.campaign import ClockOffset
from kincal.identification.streams.commands import Holds
from kincal.identification.streams.stillness import Bins
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import wrap

_PAIRS = 2000  # events of either side that are paired
_FEWER = 0.6  # of the best candidate's pairs: others are still worth a look
_CANDIDATES = 60
_BEFORE = 3  # bins before a change whose median is the pose's attitude
_ALIKE = 2.0  # times the best misfit: the plane can't tell (poses on a line); then more pairs decide


def estimate_offset(bins: Bins, holds: Holds, file: Path) -> ClockOffset:
    """The constant offset. Raises InputError where the motions don't fit the commands, or fit in several ways."""
    onsets, changes = _onsets(bins), holds.end[np.isfinite(holds.end)]
    if len(onsets) < 2 or len(changes) < 2:
        raise InputError(
            f"{file}: {len(onsets)} motions in the stream and {len(changes)} changes in the command log; the clocks' "
            "offset needs at least 2 of each: set measure.log.offset_seconds"
        )
    lags, counts = _shared_lags(onsets[:_PAIRS], changes[:_PAIRS], bins.width)
    order = np.argsort(-counts, kind="stable")
    order = order[counts[order] >= _FEWER * counts[order[0]]]
    lags, counts = lags[order], counts[order]
    fits = np.array([misfit(bins, holds, lag) for lag in lags])
    if not np.isfinite(fits).all():  # too few poses to tell by
        fits = np.ones(len(lags))
    good = np.flatnonzero(fits <= _ALIKE * fits.min())
    chosen = good[np.argmax(counts[good])]
    best = float(lags[chosen])
    rivals = good[(counts[good] == counts[chosen]) & (np.abs(lags[good] - best) > 5 * bins.width)]
    if len(rivals):
        raise InputError(
            f"{file}: the stream's clock may be {best:.2f} or {lags[rivals[0]]:.2f} s ahead of the command log's: the "
            "motions fit both; set measure.log.offset_seconds"
        )
    return _refined(onsets, changes, best, bins.width, file)


def _onsets(bins: Bins) -> np.ndarray:
    """[s] when motion began: the start of the first bin that moved after two that did not."""
    moving = bins.moving()
    begins = np.flatnonzero(moving[2:] & ~moving[1:-1] & ~moving[:-2]) + 2
    return bins.start[begins]


def _shared_lags(onsets: np.ndarray, changes: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Lags onset - change [s] that pairs share within two bins, and how many pairs do."""
    apart = np.sort((onsets[:, None] - changes[None, :]).ravel())
    counts = np.searchsorted(apart, apart + 2 * width, side="right") - np.arange(len(apart))
    lags, kept = [], []
    taken = np.zeros(len(apart), dtype=bool)
    for k in np.argsort(-counts, kind="stable"):
        if taken[k]:
            continue
        low, high = np.searchsorted(apart, [apart[k] - 2 * width, apart[k] + 4 * width])
        taken[low:high] = True
        lags.append(float(np.median(apart[k : k + counts[k]])))
        kept.append(int(counts[k]))
        if len(lags) >= _CANDIDATES:
            break
    return np.array(lags), np.array(kept)


def misfit(bins: Bins, holds: Holds, lag: float) -> float:
    """Scatter of the angles before each change about a plane in the joint values, as a share of their own; or inf."""
    k = np.searchsorted(bins.start, holds.end[np.isfinite(holds.end)] + lag - bins.width) - 1
    inside = (k >= _BEFORE) & (k < len(bins.start) - 1)
    joints, k = holds.joints[: len(k)][inside], k[inside]
    design = np.column_stack([np.ones(len(joints)), (joints - joints.mean(axis=0)) if len(joints) else joints])
    if len(joints) < design.shape[1] + 4:
        return np.inf
    angles = np.median(np.stack([bins.medians[k - j, :2] for j in range(_BEFORE)]).astype(float), axis=0)
    angles = wrap(angles - angles[0])
    angles -= angles.mean(axis=0)
    left = angles - design @ np.linalg.lstsq(design, angles, rcond=None)[0]
    freedom = (len(joints) - 1) / (len(joints) - design.shape[1])
    # every angle counts by its own spread: a pose in another place is what must show
    return float(np.sum(left**2) / max(np.sum(angles**2), 1e-30) * freedom)


def _refined(onsets: np.ndarray, changes: np.ndarray, lag: float, width: float, file: Path) -> ClockOffset:
    """The median over pairs, each onset with the nearest change."""
    for _ in range(3):
        k = np.clip(np.searchsorted(changes, onsets - lag), 1, len(changes) - 1)
        apart = np.stack([onsets - changes[k - 1], onsets - changes[k]])
        nearest = np.where(np.abs(apart[0] - lag) < np.abs(apart[1] - lag), apart[0], apart[1])
        near = nearest[np.abs(nearest - lag) <= 3 * width]
        if not len(near):
            break
        lag = float(np.median(near))
    if 2 * len(near) < min(len(onsets), len(changes)):
        raise InputError(
            f"{file}: {len(near)} of {len(onsets)} motions in the stream fit one of the {len(changes)} commanded "
            "changes; allowed is at least half: are both files of one campaign? "
            "(measure.log.offset_seconds states the offset)"
        )
    return ClockOffset(lag, len(near), float(np.std(near)))
