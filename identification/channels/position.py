"""The target's position: a tracker's, three coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from kincal.identification.channels.channel import LENGTHS, Channel, Mistake, Registered
from kincal.urdf.rigid_motion import Motion


class _Position(Channel):
    """Values: (n, 3) [m]."""

    name = "position"
    columns = ("x", "y", "z")
    column_unit = "m"
    unit = "m"
    rows = 3
    tool_axes = frozenset({0, 1, 2})
    alone = "positions alone: the target's orientation is seen only through what its lever arm moves"
    n_out = 3

    def of(self, pose: Motion) -> np.ndarray:
        return pose.translation

    def residual(self, rotation: ca.SX, translation: ca.SX, value: ca.SX) -> ca.SX:
        return translation - value

    def start_error(self, pose: Motion, values: np.ndarray) -> np.ndarray:
        return pose.translation - values

    def mistakes(self) -> Iterator[Mistake]:
        how = "(measure.columns gives a column's unit)"
        for unit, metres in LENGTHS.items():
            yield f"x, y, z are in {unit}, not metres {how}", lambda values, metres=metres: values * metres
        yield f"x, y, z are a thousand times too small {how}", lambda values: values * 1e3

    def change(self, by: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        return by[:, 3:]

    def outputs(self, robot: Registered, tool: Motion) -> np.ndarray:
        """From home along the base axes."""
        return tool.translation - robot.chain.home_pose.translation

    def measured_outputs(self, robot: Registered, values: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """The target's lever arm is turned as the model (and the tilt) has it."""
        at = robot.instrument.inverse() @ Motion(np.eye(3), values)
        return at.translation - rotation @ robot.target.translation - robot.chain.home_pose.translation

    def put(self, robot: Registered, y: np.ndarray, tool: Motion) -> Motion:
        return Motion(tool.rotation, robot.chain.home_pose.translation + y)


POSITION = _Position()
