"""Rows: late against the joints, of a target that was not seen, repeated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake, numbered, of_rows
from kincal.identification.mistakes.registered import drawn_closure, registered
from kincal.identification.mistakes.wrong_poses import MOST

_LATE = (1, -1, 2, -2, 3, -3)  # rows
_FEWEST = 8  # rows of each part
_MOVED = 10.0  # sigmas
_STUCK = 2  # readings in a row that are the same bit for bit


def late_rows(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Measured columns some rows late, or early, against the joint columns."""
    for k in _LATE:
        if len(measured) > abs(k) + _FEWEST:
            cause = f"the measured columns are {_rows(k)} against the joints"
            yield Mistake(cause, lambda m, k=k: _paired(m, k))


def late_from_some_row(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """The pairing is lost from some row on: a row was dropped, or stands twice, on one side."""
    for k in _LATE:
        if len(measured) < 3 * _FEWEST + abs(k):
            continue
        for first in dict.fromkeys(_first_late(model, measured, k, paired) for paired in (True, False)):
            if _FEWEST <= first <= len(measured) - _FEWEST:
                cause = f"from pose {measured.pose[first]} on the measured columns are {_rows(k)} against the joints"
                yield Mistake(cause, lambda m, k=k, first=first: _paired_from(m, k, first))


def _first_late(model: ErrorModel, measured: Measurements, late: int, paired: bool) -> int:
    """The row from which on residuals are smaller when paired `late` rows later; W and T are those of one end.

    paired: of the first third, which is taken for rightly paired; else of the last third, taken for late.
    """
    n, begin = len(measured), max(-late, 0)
    joints = np.arange(begin, n - max(late, 0))
    as_is, shifted = measured[joints], _joined(measured, joints, late)
    third = len(joints) // 3
    closure = drawn_closure(model, as_is.readings)
    rows = np.arange(third) if paired else np.arange(len(joints) - third, len(joints))
    robot = registered(model, (as_is if paired else shifted)[rows], closure[rows], quick=False).robot
    predicted = robot.measured(closure.pose)
    before, after = (np.sum(pose_residual(predicted, m) ** 2, axis=1) for m in (as_is, shifted))
    left = np.concatenate([np.cumsum(after[::-1])[::-1], np.zeros(begin + 1)])
    total = np.concatenate([[0.0], np.cumsum(before)]) + left[begin:]  # of early ones the first have no partner
    return begin + int(np.argmin(total))


def unseen_target(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Rows of zeros and identities, as recorders write them for a target that they do not see."""
    for channels in [list(measured.values), *([c] for c in measured.values)]:
        empty = np.ones(len(measured), dtype=bool)
        for channel in channels:
            values = measured.values[channel]
            nothing = np.eye(3) if channel == "orientation" else 0.0
            empty &= (values == nothing).reshape(len(values), -1).all(axis=1)
        if empty.any() and not empty.all():
            what = "hold zeros" if len(channels) > 1 else f"hold zeros in {channels[0]}"
            yield of_rows(f"{numbered(measured.pose[empty])} {what}: the target was not seen there", measured, empty)
            return


def repeated_rows(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Rows whose measurement is bit for bit that of the row before, though the joints moved."""
    same = np.ones(len(measured) - 1, dtype=bool)
    for values in measured.values.values():
        flat = values.reshape(len(values), -1)
        same &= (flat[1:] == flat[:-1]).all(axis=1)
    moved = (measured.readings[1:] != measured.readings[:-1]).any(axis=1)
    wrong = np.concatenate([[False], same & moved])
    if wrong.any():
        yield of_rows(f"{numbered(measured.pose[wrong])} repeat the measurement of the row before", measured, wrong)


def stuck_joints(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """A joint whose reading stays the same to the last bit for some rows, while others move."""
    readings = measured.readings
    moved = (readings[1:] != readings[:-1]).any(axis=1) | _seen_to_move(measured)
    for j, name in enumerate(model.chain.actuated_names):
        same = np.concatenate([[False], (readings[1:, j] == readings[:-1, j]) & moved])
        starts, lengths = _runs(same)
        runs = [slice(s, s + n) for s, n in zip(starts, lengths, strict=True) if n >= _STUCK - 1]
        wrong = np.zeros(len(readings), dtype=bool)
        for run in runs:
            wrong[run] = True
        if runs and wrong.mean() > MOST:  # poses on a grid repeat readings; one that is stuck may be so to the end
            wrong[: runs[-1].start] = False
            wrong[:] &= runs[-1].stop == len(wrong)
        if wrong.any() and not wrong.all():
            first = measured.pose[np.argmax(wrong)]
            count = int(wrong.sum())
            where = f"at {count} pose{'s' * (count > 1)}"
            cause = f"the reading of {name} is stuck from pose {first} on, {where}, while the robot moves"
            yield replace(of_rows(cause, measured, wrong), wrong=())


def _seen_to_move(measured: Measurements) -> np.ndarray:
    """(n - 1,) bool: whether a pose was measured elsewhere than the one before."""
    moved = np.zeros(len(measured) - 1, dtype=bool)
    for channel in named(measured.channels):
        values = channel.observed(measured.values[channel.name])
        sigma = measured.std[channel.name][1:, None]
        moved |= (np.abs(np.diff(values, axis=0)) > _MOVED * sigma).any(axis=1)
    return moved


def _rows(k: int) -> str:
    return f"{abs(k)} row{'s' * (abs(k) > 1)} {'late' if k > 0 else 'early'}"


def _runs(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First rows and lengths of the runs of True in flags (n,)."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def _paired(m: Measurements, late: int) -> Measurements:
    rows = np.arange(len(m))
    return _joined(m, rows[: len(m) - late] if late > 0 else rows[-late:], late)


def _paired_from(m: Measurements, late: int, first: int) -> Measurements:
    rows = np.arange(len(m))
    after = rows[first : len(m) - late] if late > 0 else rows[first - late :]
    before, paired = m[:first], _joined(m, after, late)
    together = {c: np.concatenate([before.values[c], paired.values[c]]) for c in m.values}
    std = {c: np.concatenate([before.std[c], paired.std[c]]) for c in m.std}
    pose, readings = (np.concatenate([getattr(before, k), getattr(paired, k)]) for k in ("pose", "readings"))
    return Measurements(pose, readings, together, std, m.assumed)


def _joined(m: Measurements, joints: np.ndarray, late: int) -> Measurements:
    """The joints of these rows with what was measured `late` rows later."""
    shifted = m[joints + late]
    return Measurements(m.pose[joints], m.readings[joints], shifted.values, shifted.std, m.assumed)
