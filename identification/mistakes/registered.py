"""W and T alone, fitted to the robot as drawn without derivatives of the mechanism: fast enough for many mistakes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.registration import starts
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import Closure, forward
from kincal.urdf.rigid_motion import Motion

_STEPS = 3  # Gauss-Newton; the closed-form start is near
_SMALL = 1e-6  # of a difference [m, rad]
_BEYOND = 0.3  # of a joint's range, beyond its limits: no readings of this robot
_TRIED = 4  # poses whose loops are closed first


@dataclass(frozen=True)
class Registered:
    """A robot as drawn, with W and T that fit some poses."""

    robot: BuiltRobot
    q: np.ndarray  # (n, n_joints) closed configurations at the readings
    tool: Motion  # (n) poses in the base frame at the readings
    residual: np.ndarray  # (n, rows a pose) whitened

    @property
    def size(self) -> float:
        """Mean square of the residuals."""
        return float(np.mean(self.residual**2))


def drawn_closure(model: ErrorModel, readings: np.ndarray, start: np.ndarray | None = None) -> Closure:
    """Of the robot as drawn. Raises InputError where the loops do not close at some readings.

    start: (n, n_joints), closed configurations near by where they are known.
    """
    drawn = model.robot(np.zeros(len(model.parameters)))
    chain, joints = drawn.chain, drawn.actuators.joints(readings)
    low, high = chain.lower[chain.actuated], chain.upper[chain.actuated]
    slack = np.where(np.isfinite(high - low), _BEYOND * (high - low), np.inf)
    if np.any(joints < low - slack) or np.any(joints > high + slack):
        raise InputError("joint values are far beyond their limits")
    if start is not None:
        closure = forward(chain, joints, start, direct=True)
        if closure.closed.all():
            return closure
    few = np.unique(np.linspace(0, len(readings) - 1, _TRIED).astype(int))
    for rows in (few, np.arange(len(readings))):  # most readings that can't be are found by the first few
        closure = forward(chain, joints[rows], direct=True)
        if not closure.closed.all():
            raise InputError("the loops can't be closed at these readings")
    return closure


def registered(
    model: ErrorModel,
    measured: Measurements,
    closure: Closure | None = None,
    near: BuiltRobot | None = None,
    quick: bool = True,
) -> Registered:
    """The best of the closed-form starts, improved. Raises InputError.

    closure: at the readings, where it is known; near: a robot with W and T near by, in place of the starts.
    quick: no start is looked for where what was measured is no turn of the tool.
    """
    closure = drawn_closure(model, measured.readings) if closure is None else closure
    tool = closure.pose
    drawn = model.robot(np.zeros(len(model.parameters)))
    robots = [near] if near else [replace(drawn, instrument=w, target=t) for w, t in starts(tool, measured, quick)]
    sizes = [float(np.sum(pose_residual(robot.measured(tool), measured) ** 2)) for robot in robots]
    robot = robots[int(np.argmin(sizes))]
    residual = pose_residual(robot.measured(tool), measured)
    for _ in range(_STEPS):
        columns = np.stack([_difference(robot, tool, measured, residual, k) for k in range(12)], axis=-1)
        step = -np.linalg.lstsq(columns.reshape(-1, 12), residual.ravel(), rcond=1e-9)[0]
        better = _stepped(robot, step)
        after = pose_residual(better.measured(tool), measured)
        if np.sum(after**2) >= np.sum(residual**2):
            break
        robot, residual = better, after
    return Registered(robot, closure.q, tool, residual)


def frame_columns(at: Registered, measured: Measurements) -> np.ndarray:
    """(n, rows a pose, 12): derivatives of the residuals by small moves of W and T."""
    columns = [_difference(at.robot, at.tool, measured, at.residual, k) for k in range(12)]
    return np.stack(columns, axis=-1)


def _difference(robot: BuiltRobot, tool: Motion, measured: Measurements, residual: np.ndarray, k: int) -> np.ndarray:
    step = np.zeros(12)
    step[k] = _SMALL
    return (pose_residual(_stepped(robot, step).measured(tool), measured) - residual) / _SMALL


def _stepped(robot: BuiltRobot, step: np.ndarray) -> BuiltRobot:
    return replace(
        robot,
        instrument=Motion.from_vector(step[:6]) @ robot.instrument,
        target=robot.target @ Motion.from_vector(step[6:]),
    )
