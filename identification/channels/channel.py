"""A channel: one kind of measurement, and all that kincal does with it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Literal, Protocol

import casadi as ca
import numpy as np
import pandas as pd

from kincal.identification.identification import HUMAN
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.rigid_motion import Motion

UP = np.array([0.0, 0.0, 1.0])  # the vertical in the measurement frame

LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}  # [m] that people take for metres
Mistake = tuple[str, Callable[[np.ndarray], np.ndarray]]  # what is wrong, and the values without it


class Registered(Protocol):
    """A robot between its instrument and its target, as a chart needs it."""

    @property
    def chain(self) -> ClosedChain: ...

    @property
    def instrument(self) -> Motion: ...  # W

    @property
    def target(self) -> Motion: ...  # T


class Channel(ABC):
    """Values of n poses are (n, k), or (n,) of one column; in SI units and radians, in the measurement frame.

    `urdf.description.SENSORS` names the unit and the usual size of its sigma in robot.toml.
    """

    name: str
    columns: tuple[str, ...]  # of the measurement table
    column_unit: Literal["m", "rad", "1"]
    unit: Literal["m", "rad"]  # of its residuals and of its sigma
    rows: int  # residuals a pose
    parts: frozenset[str]  # what of a pose its values are; default: something of its own
    size: int  # numbers that hold one pose's values; default: rows
    other_columns: tuple[tuple[str, ...], ...] = ()  # other ways to give the same, which `canonical` turns into columns
    tool_axes: frozenset[int] = frozenset()  # measured by default where the tool is free along one of these
    registers: bool = True  # whether W and T can be looked for with this channel alone
    alone: str = ""  # what this channel never shows where nothing else is measured
    scored: bool = True
    score_axes: str = ""  # axes that a turn is also scored about
    n_out: int = 0  # coordinates of the networks' chart; 0: the networks do not learn it

    def __init_subclass__(cls) -> None:
        cls.parts = cls.__dict__.get("parts", frozenset([cls.name]))
        cls.size = cls.__dict__.get("size", cls.rows)

    @property
    def human(self) -> tuple[str, float]:
        """The unit that people read, and how many of it are one of `unit`."""
        return HUMAN[self.unit]

    @property
    def field(self) -> str:
        """Its name with the unit that people read: tilt_deg."""
        return f"{self.name}_{self.human[0]}"

    # The measurement table

    def canonical(self, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """A table's columns without `other_columns`."""
        return columns

    def wrong_row(self, columns: Mapping[str, np.ndarray]) -> tuple[int, str] | None:
        """The first row that can't be, and why."""
        return None

    def read(self, table: pd.DataFrame) -> np.ndarray:
        """Values of the columns."""
        values = table[list(self.columns)].to_numpy(float)
        return values[:, 0] if values.shape[1] == 1 else values

    def write(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of the values."""
        return dict(zip(self.columns, np.atleast_2d(values.T), strict=True))

    # Identification

    @abstractmethod
    def of(self, pose: Motion) -> np.ndarray:
        """The values of poses (n)."""

    @abstractmethod
    def residual(self, rotation: ca.SX, translation: ca.SX, value: ca.SX) -> ca.SX:
        """(rows,) predicted less measured, of one pose [unit]. value: (size,), as `observed` orders it."""

    def observed(self, values: np.ndarray) -> np.ndarray:
        """(n, size)"""
        return values.reshape(len(values), -1)

    def start_error(self, pose: Motion, values: np.ndarray) -> np.ndarray | None:
        """How far poses (n) are from the values, to choose a start for W and T by; None: it does not count."""
        return None

    def moved(self, values: np.ndarray, before: Motion, after: Motion) -> np.ndarray:
        """Values at poses (n) near `before`, as they would be at poses `after`, a small move away."""
        return values + self.of(after) - self.of(before)

    def mistakes(self) -> Iterator[Mistake]:
        """The usual ones; that an angle is in degrees is tried of all."""
        return iter(())

    # Scores

    def error(self, actual: Motion, predicted: Motion) -> np.ndarray:
        """(n, k) [unit]"""
        return (self.of(predicted) - self.of(actual)).reshape(len(actual.translation), -1)

    @abstractmethod
    def change(self, by: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """(n, k, m): of small changes of poses (n, 6, m), what this channel shows.

        by: rotation vectors in the target's frame [rad], and positions [m]. rotation: (n, 3, 3) of the poses.
        """

    def covariance(self, of_pose: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """(n, k, k) from that of poses (n, 6, 6), in the order of `change`."""
        half = self.change(of_pose, rotation).swapaxes(1, 2)
        return self.change(half, rotation).swapaxes(1, 2)

    # A virtual robot

    def sensed(self, pose: Motion, cross_axis: float) -> np.ndarray:
        """The values as an instrument has them without noise. cross_axis: share of one angle read into another."""
        return self.of(pose)

    def noisy(self, values: np.ndarray, sigma: float, random: np.random.Generator) -> np.ndarray:
        return values + sigma * random.normal(size=values.shape)

    # The networks' chart: coordinates that are regular at home

    def outputs(self, robot: Registered, tool: Motion) -> np.ndarray:
        """(n, n_out) of tool poses in the base frame."""
        raise NotImplementedError

    def measured_outputs(self, robot: Registered, values: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """(n, n_out) of values. rotation: (n, 3, 3) of the tool, as far as the model and other channels tell."""
        raise NotImplementedError

    def put(self, robot: Registered, y: np.ndarray, tool: Motion) -> Motion:
        """Tool poses (n) with the outputs y: (n, n_out) put in."""
        raise NotImplementedError
