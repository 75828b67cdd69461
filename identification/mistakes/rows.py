"""Rows: late against the joints, of a target that was not seen, repeated, or simply wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import registered, tool_poses
from kincal.urdf.description import listed

_LATE = (1, -1, 2, -2, 3, -3)  # rows
_ROUNDS = 6  # of trimming
_MOST = 0.35  # of the poses, that may be wrong
_FAR = 6.0  # sigmas and tolerances of a pose that does not fit the others


def late_rows(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Measured columns some rows late, or early, against the joint columns."""
    for k in _LATE:
        if len(measured) > abs(k) + 6:
            when = "late" if k > 0 else "early"
            cause = f"the measured columns are {abs(k)} row{'s' * (abs(k) > 1)} {when} against the joints"
            yield Mistake(cause, lambda m, k=k: _paired(m, k))


def unseen_target(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Rows of zeros and identities, as recorders write them for a target that they do not see."""
    empty = np.ones(len(measured), dtype=bool)
    for channel, values in measured.values.items():
        nothing = np.eye(3) if channel == "orientation" else 0.0
        empty &= (values == nothing).reshape(len(values), -1).all(axis=1)
    if empty.any() and not empty.all():
        cause = f"poses {listed(measured.pose[empty])} hold zeros: the target was not seen there; leave them out"
        yield Mistake(cause, lambda m: m[~empty])


def repeated_rows(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Rows whose measurement is bit for bit that of the row before, though the joints moved."""
    same = np.ones(len(measured) - 1, dtype=bool)
    for values in measured.values.values():
        flat = values.reshape(len(values), -1)
        same &= (flat[1:] == flat[:-1]).all(axis=1)
    rows = np.concatenate([[False], same & (measured.readings[1:] != measured.readings[:-1]).any(axis=1)])
    if rows.any():
        cause = f"poses {listed(measured.pose[rows])} repeat the measurement of the row before; leave them out"
        yield Mistake(cause, lambda m: m[~rows])


def wrong_poses(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Some poses that do not fit the others: least trimmed squares, then all that fit are taken back."""
    wrong = _not_fitting(model, measured)
    if wrong.any() and wrong.mean() <= _MOST:
        cause = (
            f"poses {listed(measured.pose[wrong])} do not fit the others; leave them out, or set identify.loss = "
            '"cauchy"'
        )
        yield Mistake(cause, lambda m: m[~wrong])


def _paired(m: Measurements, late: int) -> Measurements:
    n = len(m)
    joints, values = (slice(0, n - late), slice(late, n)) if late > 0 else (slice(-late, n), slice(0, n + late))
    rows = np.arange(n)
    shifted = m[rows[values]]
    return Measurements(m.pose[joints], m.readings[joints], shifted.values, shifted.std, m.assumed)


def _not_fitting(model: ErrorModel, measured: Measurements) -> np.ndarray:
    """(n,) poses whose residual is far beyond that of the others, registered to them alone. Raises InputError."""
    tool, kept = tool_poses(model, measured.readings), np.arange(len(measured))
    size = np.zeros(len(measured))
    for _ in range(_ROUNDS):
        found = registered(model, measured[kept], tool[kept])
        size = np.linalg.norm(pose_residual(found.robot.measured(tool), measured), axis=1)
        before, kept = kept, np.sort(np.argsort(size)[: max(int((1 - _MOST) * len(measured)), 8)])
        if np.array_equal(before, kept):
            break
    return size > _FAR * float(np.median(size[kept]))
