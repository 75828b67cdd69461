"""An actuator, or the instrument, that is off by more in some rows than in others, by a law.

It drifts along the rows (temperature, a slipping coupling, a tripod that sinks), it settles after the first rows (a
machine that warms up), or an actuator stops elsewhere when it comes from the other side (backlash).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import frame_columns
from kincal.urdf.rigid_motion import Motion

DRIFT = "a drift of"  # `drift_finding` tells of it too
_FEWEST = 8  # poses
_TIMES = 2  # linearisations
_SHARE = 0.5  # of the fall that the best law brings, the least of one that is worth a look
_SETTLING = (0.05, 0.15)  # of the rows, after which 1/e is left


@dataclass(frozen=True)
class _Law:
    """How the offset goes, over a range of 1, with the rows."""

    words: str  # before the name of the part, and behind it
    behind: str
    share: float = 0.0  # of the rows: of settling
    by_direction: bool = False

    def profile(self, m: Measurements, joint: int | None) -> np.ndarray:
        """(n,)"""
        if self.by_direction:
            readings = m.readings[:, joint or 0]
            return 0.5 * np.sign(np.diff(readings, prepend=readings[0]))
        rows = np.arange(len(m)) / max(len(m) - 1, 1)
        return np.exp(-rows / self.share) if self.share else rows - 0.5


_LAWS = (
    _Law(DRIFT, "from the first pose to the last"),
    *(_Law("settling of", "at the first pose", share=share) for share in _SETTLING),
    _Law("backlash of", "between the directions of approach", by_direction=True),
)


@dataclass(frozen=True)
class _Offset:
    """Of one part, by a law."""

    law: _Law
    size: np.ndarray  # (1,) of an actuator's zero; (6,) of the instrument's small move
    fall: float  # of the sum of squares
    joint: int | None  # None: the instrument

    def words(self, model: ErrorModel) -> str:
        if self.joint is not None:
            name = model.chain.actuated_names[self.joint]
            slides = model.chain.prismatic[model.chain.actuated[self.joint]]
            unit, factor = HUMAN["m" if slides else "rad"]
            size = f"{factor * self.size[0]:+.3g} {unit}"
        else:
            name = "the instrument"
            moved, turned = 1e3 * np.linalg.norm(self.size[:3]), np.rad2deg(np.linalg.norm(self.size[3:]))
            size = f"{turned:.3g} deg and {moved:.3g} mm"
        along = " along the rows" if self.law.words == DRIFT else ""
        return f"{self.law.words} {name}{along} ({size} {self.law.behind})"


def drifting_part(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One actuator, or the instrument: linear in the number of the row, settling, or by the direction of approach."""
    if len(measured) < _FEWEST:
        return
    robot = LinearRobot.of(model, measured)
    joints = range(len(model.chain.actuated_names))
    parts = [(law, joint) for law in _LAWS for joint in (*joints, *([] if law.by_direction else [None]))]
    offsets = [_offset(model, robot, measured, *part) for part in parts]
    most = max(offset.fall for offset in offsets)
    for offset in offsets:
        if offset.fall > _SHARE * most:
            undone = partial(_without, model, law=offset.law, joint=offset.joint)
            yield Mistake(offset.words(model), undone, lasting=True)


def _offset(model: ErrorModel, robot: LinearRobot, measured: Measurements, law: _Law, joint: int | None) -> _Offset:
    factor, change = robot.solved(np.ones(len(measured)))
    left = (robot.residual + robot.jacobian @ change).ravel()
    if joint is None:
        by_part = frame_columns(robot.at, measured)[:, :, :6]
    else:
        index = model.zeros.start + joint
        by_part = robot.jacobian[:, :, [index]] / model.parameters.tolerance[index]
    columns = (by_part * law.profile(measured, joint)[:, None, None]).reshape(len(left), -1)
    half = np.linalg.solve(factor, robot.jacobian.reshape(len(left), -1).T @ columns)  # the parameters move along
    slope = columns.T @ left
    size = -np.linalg.lstsq(columns.T @ columns - half.T @ half, slope, rcond=1e-9)[0]
    return _Offset(law, size, float(-slope @ size), joint)


def _without(model: ErrorModel, m: Measurements, law: _Law, joint: int | None) -> Measurements:
    """Raises InputError."""
    profile = law.profile(m, joint)
    for _ in range(_TIMES):
        robot = LinearRobot.of(model, m)
        size = _offset(model, robot, m, law, joint).size
        if joint is not None:
            readings = m.readings.copy()
            readings[:, joint] += size[0] * profile / model.actuators.gain[joint]
            m = replace(m, readings=readings)
            continue
        pose = robot.at.robot.measured(robot.at.tool)
        moved = Motion.from_vector(profile[:, None] * size) @ pose
        m = m.replaced(**{c.name: c.moved(m.values[c.name], moved, pose) for c in named(m.channels)})
    return m
