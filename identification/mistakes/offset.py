"""A part that is off by a small move, by more in some rows than in others: how far, and what it explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.registered import frame_columns
from kincal.urdf.rigid_motion import Motion

Part: TypeAlias = 'int | Literal["instrument", "target"]'  # of actuators the number
Profile: TypeAlias = Callable[[Measurements], np.ndarray]  # (n,) the share of the move in each row


@dataclass(frozen=True)
class Offset:
    """The move that explains most, all parameters moved along."""

    size: np.ndarray  # (1,) of an actuator [m, rad]; (6,) of an instrument or a target, as a Motion's vector
    fall: float  # of the sum of squares


@dataclass(frozen=True)
class Offsets:
    """Of one table."""

    model: ErrorModel
    measured: Measurements
    robot: LinearRobot

    @classmethod
    def of(cls, model: ErrorModel, measured: Measurements) -> Offsets:
        """Raises InputError where the loops do not close at the readings."""
        return cls(model, measured, LinearRobot.of(model, measured))

    def along(self, part: Part, profile: np.ndarray) -> Offset:
        """profile: (n,)"""
        n_rows = len(self._left.ravel())
        columns = (self._columns(part) * profile[:, None, None]).reshape(n_rows, -1)
        mixed = columns.T @ self.robot.jacobian.reshape(n_rows, -1)
        return self._offset(columns.T @ columns, mixed, columns.T @ self._left.ravel())

    def from_some_row(self, part: Part, fewest: int) -> tuple[int, Offset]:
        """The first row, `fewest` from either end, from which on a move explains most."""
        columns = self._columns(part)
        # sums over the rows from the end: what a move from row k on would see
        square, mixed, slope = (
            np.cumsum(each[::-1], axis=0)[::-1]
            for each in (
                np.einsum("nri,nrj->nij", columns, columns),
                np.einsum("nri,nrj->nij", columns, self.robot.jacobian),
                np.einsum("nri,nr->ni", columns, self._left),
            )
        )
        rows = range(fewest, len(self.measured) - fewest + 1)
        offsets = {k: self._offset(square[k], mixed[k], slope[k]) for k in rows}
        return max(offsets.items(), key=lambda entry: entry[1].fall)

    def foreseen(self, offset: Offset) -> float:
        """The misfit without the move, to first order."""
        return self.robot.misfit - offset.fall / self.robot.freedom

    def undone(self, part: Part, profile: np.ndarray) -> Measurements:
        """The measurements as they would be without the move, to first order."""
        size, m = self.along(part, profile).size, self.measured
        if isinstance(part, int):
            readings = m.readings.copy()
            readings[:, part] += size[0] * profile / self.model.actuators.gain[part]
            return replace(m, readings=readings)
        pose, after = self.robot.predicted, self.moved(part, Motion.from_vector(profile[:, None] * size))
        return m.replaced(**{c.name: c.moved(m.values[c.name], after, pose) for c in named(m.channels)})

    def moved(self, part: Part, move: Motion) -> Motion:
        """(n) predicted poses after a move of the instrument or the target."""
        return move @ self.robot.predicted if part == "instrument" else self.robot.predicted @ move

    def _columns(self, part: Part) -> np.ndarray:
        """(n, rows a pose, k): derivatives of the residuals by the part's move."""
        if isinstance(part, int):
            index = self.model.zeros.start + part
            return self.robot.jacobian[:, :, [index]] / self.model.parameters.tolerance[index]
        return self._of_frames[:, :, :6] if part == "instrument" else self._of_frames[:, :, 6:]

    def _offset(self, square: np.ndarray, mixed: np.ndarray, slope: np.ndarray) -> Offset:
        half = np.linalg.solve(self._solved[0], mixed.T)  # the parameters move along: Schur complement
        size = -np.linalg.lstsq(square - half.T @ half, slope, rcond=1e-9)[0]
        return Offset(size, float(-slope @ size))

    @cached_property
    def _of_frames(self) -> np.ndarray:
        return frame_columns(self.robot.at, self.measured)

    @cached_property
    def _solved(self) -> tuple[np.ndarray, np.ndarray]:
        return self.robot.solved()

    @cached_property
    def _left(self) -> np.ndarray:
        """(n, rows a pose) residuals after the step of the parameters alone."""
        return self.robot.after(self._solved[1])


def without(model: ErrorModel, m: Measurements, part: Part, profile: Profile, times: int) -> Measurements:
    """`Offsets.undone`, `times` linearisations. Raises InputError."""
    shares = profile(m)
    for _ in range(times):
        m = Offsets.of(model, m).undone(part, shares)
    return m
