"""An actuator, or the instrument, that drifts along the rows: temperature, a slipping coupling, a tripod that sinks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import frame_columns
from kincal.urdf.rigid_motion import Motion

_FEWEST = 8  # poses
_TIMES = 2  # linearisations
_SHARE = 0.5  # of the fall that the best drift brings, the least of one that is worth a look


@dataclass(frozen=True)
class _Drift:
    """A linear one, from -1/2 of its size at the first pose to 1/2 at the last."""

    size: np.ndarray  # (1,) of an actuator's zero; (6,) of the instrument's small move
    fall: float  # of the sum of squares
    joint: int | None  # None: the instrument

    def words(self, model: ErrorModel) -> str:
        if self.joint is not None:
            name = model.chain.actuated_names[self.joint]
            slides = model.chain.prismatic[model.chain.actuated[self.joint]]
            unit, factor = HUMAN["m" if slides else "rad"]
            size = f"{factor * self.size[0]:+.3g} {unit}"
            return f"a drift of {name} along the rows ({size} from the first pose to the last)"
        moved, turned = 1e3 * np.linalg.norm(self.size[:3]), np.rad2deg(np.linalg.norm(self.size[3:]))
        size = f"{turned:.3g} deg and {moved:.3g} mm"
        return f"a drift of the instrument along the rows ({size} from the first pose to the last)"


def drifting_part(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One actuator, or the instrument, linearly in the number of the row."""
    if len(measured) < _FEWEST:
        return
    robot = LinearRobot.of(model, measured)
    drifts = [_drift(model, robot, measured, joint) for joint in (*range(len(model.chain.actuated_names)), None)]
    most = max(drift.fall for drift in drifts)
    for drift in drifts:
        if drift.fall > _SHARE * most:
            yield Mistake(drift.words(model), lambda m, j=drift.joint: _without(model, m, j), lasting=True)


def _drift(model: ErrorModel, robot: LinearRobot, measured: Measurements, joint: int | None) -> _Drift:
    factor, change = robot.solved(np.ones(len(measured)))
    left = (robot.residual + robot.jacobian @ change).ravel()
    if joint is None:
        by_part = frame_columns(robot.at, measured)[:, :, :6]
    else:
        index = model.zeros.start + joint
        by_part = robot.jacobian[:, :, [index]] / model.parameters.tolerance[index]
    columns = (by_part * _ramp(len(measured))[:, None, None]).reshape(len(left), -1)
    half = np.linalg.solve(factor, robot.jacobian.reshape(len(left), -1).T @ columns)  # the parameters move along
    slope = columns.T @ left
    size = -np.linalg.lstsq(columns.T @ columns - half.T @ half, slope, rcond=1e-9)[0]
    return _Drift(size, float(-slope @ size), joint)


def _without(model: ErrorModel, m: Measurements, joint: int | None) -> Measurements:
    """Raises InputError."""
    ramp = _ramp(len(m))
    for _ in range(_TIMES):
        robot = LinearRobot.of(model, m)
        size = _drift(model, robot, m, joint).size
        if joint is not None:
            readings = m.readings.copy()
            readings[:, joint] += size[0] * ramp / model.actuators.gain[joint]
            m = replace(m, readings=readings)
            continue
        pose = robot.at.robot.measured(robot.at.tool)
        drifted = Motion.from_vector(ramp[:, None] * size) @ pose
        m = m.replaced(**{c.name: c.moved(m.values[c.name], drifted, pose) for c in named(m.channels)})
    return m


def _ramp(n: int) -> np.ndarray:
    return np.linspace(-0.5, 0.5, n)
