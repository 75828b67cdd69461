"""An instrument, or a target, that moved during the campaign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import frame_columns
from kincal.urdf.rigid_motion import Motion, log

_FEWEST = 6  # poses before and after
_TIMES = 3  # linearisations
_MOVES = (("instrument", slice(0, 6)), ("target", slice(6, 12)))  # W's columns, and T's


def moved_part(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """The instrument, or the target, sits elsewhere from some row on: the row, and the move, that explain most."""
    if len(measured) < 2 * _FEWEST:
        return
    robot = LinearRobot.of(model, measured)
    for part, columns in _MOVES:
        first, step = _step(robot, measured, columns, None)
        when = f"between poses {measured.pose[first - 1]} and {measured.pose[first]}"
        cause = f"the {part} moved {when} ({_size(robot, measured, Motion.from_vector(step), part)})"
        yield Mistake(cause, lambda m, first=first, columns=columns: _moved_back(model, m, columns, first))


def _step(robot: LinearRobot, measured: Measurements, part: slice, first: int | None) -> tuple[int, np.ndarray]:
    """The first row of the second part, and the small move (6,) there; first: known already."""
    factor, change = robot.solved(np.ones(len(measured)))
    left = robot.residual + robot.jacobian @ change
    columns = frame_columns(robot.at, measured)[:, :, part]
    # sums over the rows from the end: what a move from row k on would see
    square, mixed, slope = (
        np.cumsum(each[::-1], axis=0)[::-1]
        for each in (
            np.einsum("nri,nrj->nij", columns, columns),
            np.einsum("nri,nrj->nij", columns, robot.jacobian),
            np.einsum("nri,nr->ni", columns, left),
        )
    )
    best, chosen = (-1.0, 0), np.zeros(6)
    for k in range(_FEWEST, len(measured) - _FEWEST + 1) if first is None else (first,):
        half = np.linalg.solve(factor, mixed[k].T)  # the parameters move along: Schur complement
        information = square[k] - half.T @ half
        step = -np.linalg.lstsq(information, slope[k], rcond=1e-9)[0]
        fall = float(-slope[k] @ step)
        if fall > best[0]:
            best, chosen = (fall, k), step
    return best[1], chosen


def _size(robot: LinearRobot, measured: Measurements, move: Motion, part: str) -> str:
    """How far the target seems to have moved: by its turn, and where positions are measured by their mean shift."""
    pose = robot.at.robot.measured(robot.at.tool)
    after = move @ pose if part == "instrument" else pose @ move
    turned = f"{np.rad2deg(np.linalg.norm(log(move.rotation))):.2g} deg"
    shift = 1e3 * np.mean(np.linalg.norm(after.translation - pose.translation, axis=1))
    return f"{shift:.2g} mm, {turned}" if "position" in measured.values else turned


def _moved_back(model: ErrorModel, m: Measurements, part: slice, first: int) -> Measurements:
    """Raises InputError."""
    later = np.arange(first, len(m))
    for _ in range(_TIMES):
        robot = LinearRobot.of(model, m)
        _, step = _step(robot, m, part, first)
        move = Motion.from_vector(step)
        pose = robot.at.robot.measured(robot.at.tool)[later]
        after = move @ pose if part.start == 0 else pose @ move
        values = {}
        for channel in named(m.channels):
            back = channel.moved(m.values[channel.name][later], after, pose)
            values[channel.name] = np.concatenate([m.values[channel.name][:first], back])
        m = m.replaced(**values)
    return m
