"""Measured poses as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from kincal.identification.channels import BY_ROWS, CHANNELS, named
from kincal.identification.channels.orientation import quaternions as quaternions
from kincal.urdf.description import Sensor
from kincal.urdf.rigid_motion import Motion, from_zyx_angles


@dataclass(frozen=True)
class Measurements:
    """n measured poses in the measurement frame, as arrays in SI units and radians.

    readings: (n, n_actuated), as the actuators' encoders gave them, never corrected.
    """

    pose: np.ndarray  # (n,) the poses' numbers
    readings: np.ndarray
    values: Mapping[str, np.ndarray] = field(default_factory=dict)  # by channel; what was not measured is not there
    std: Mapping[str, np.ndarray] = field(default_factory=dict)  # by channel: (n,) one sigma about or along each axis
    assumed: tuple[str, ...] = ()  # channels whose sigma nobody gave: a first guess, to be estimated

    def __len__(self) -> int:
        return len(self.readings)

    def __getitem__(self, rows) -> Measurements:
        values, std = ({c: v[rows] for c, v in of.items()} for of in (self.values, self.std))
        return replace(self, pose=self.pose[rows], readings=self.readings[rows], values=values, std=std)

    def shared_with(self, other: Measurements) -> int:
        """How many rows stand bit for bit in `other`, too: readings, and all that was measured."""
        if self.channels != other.channels:
            return 0
        rows = {row.tobytes() for row in other._rows()}
        return sum(row.tobytes() in rows for row in self._rows())

    def _rows(self) -> np.ndarray:
        parts = [self.readings, *(self.values[c].reshape(len(self), -1) for c in self.channels)]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))

    def only(self, channels: Sequence[str]) -> Measurements:
        """Without the other channels."""
        values, std = ({c: v for c, v in of.items() if c in channels} for of in (self.values, self.std))
        return replace(self, values=values, std=std, assumed=tuple(c for c in self.assumed if c in channels))

    def replaced(self, **values: np.ndarray) -> Measurements:
        """With other values of some channels."""
        return replace(self, values={**self.values, **values})

    def scaled(self, factors: Mapping[str, float]) -> Measurements:
        """The same readings with the sigmas of some channels multiplied: no longer assumed."""
        std = {c: sigma * factors[c] if c in factors else sigma for c, sigma in self.std.items()}
        return replace(self, std=std, assumed=tuple(c for c in self.assumed if c not in factors))

    @property
    def rows_a_pose(self) -> int:
        return sum(c.rows for c in named(self.channels))

    @property
    def rows(self) -> int:
        """All readings: the rows of the identification Jacobian."""
        return len(self) * self.rows_a_pose

    def as_poses(self) -> Motion:
        """What was measured, as poses (n); what was not is the identity, and must not be scored."""
        rotation, n = self.values.get("orientation"), len(self)
        if rotation is None:
            tilt, yaw = self.values.get("tilt", np.zeros((n, 2))), self.values.get("yaw", np.zeros(n))
            rotation = from_zyx_angles(np.column_stack([yaw, tilt[:, 1], tilt[:, 0]]))
        return Motion(rotation, self.values.get("position", np.zeros((n, 3))))

    @property
    def channels(self) -> tuple[str, ...]:
        """What was measured, in the order of residuals."""
        return tuple(c.name for c in BY_ROWS if c.name in self.values)


def default_channels(tool_axes: tuple[int, ...]) -> tuple[str, ...]:
    """All that can move: orientation where the robot turns its tool, position where it carries it."""
    return tuple(c.name for c in CHANNELS if c.tool_axes & set(tool_axes))


def to_measurements(table: pd.DataFrame, joints: Sequence[str], sensor: Sensor) -> Measurements:
    """The canonical table as arrays; sigmas come from its *_std columns, else from [sensor]."""
    values = {c.name: c.read(table) for c in CHANNELS if c.columns[0] in table}
    given = {c: f"{c}_std" for c in values if f"{c}_std" in table}
    std = {c: table[given[c]].to_numpy(float) if c in given else np.full(len(table), sensor.sigma(c)) for c in values}
    assumed = tuple(c for c in values if c not in given and not sensor.given(c))
    return Measurements(table["pose"].to_numpy(), table[list(joints)].to_numpy(float), values, std, assumed)


def to_table(joints: Sequence[str], readings: np.ndarray, measured: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """The canonical table of readings (n, n_actuated) and of measured columns, poses numbered from 0."""
    columns = {name: readings[:, k] for k, name in enumerate(joints)}
    return pd.DataFrame({"pose": np.arange(len(readings)), **columns, **measured})
