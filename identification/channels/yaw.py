"""Yaw: a heading reference's. Beside tilt it makes the orientation whole."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from kincal.identification.channels.channel import Channel, Mistake
from kincal.identification.channels.instrument import read_angles
from kincal.identification.symbolic_chain import wrapped
from kincal.urdf.rigid_motion import Motion


class _Yaw(Channel):
    """Values: (n,) [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""

    name = "yaw"
    columns = ("yaw",)
    column_unit = "rad"
    unit = "rad"
    rows = 1
    registers = False
    scored = False

    def of(self, pose: Motion) -> np.ndarray:
        return np.arctan2(pose.rotation[:, 1, 0], pose.rotation[:, 0, 0])

    def residual(self, rotation: ca.SX, translation: ca.SX, value: ca.SX) -> ca.SX:
        return wrapped(ca.atan2(rotation[1, 0], rotation[0, 0]) - value)

    def mistakes(self) -> Iterator[Mistake]:
        yield "yaw has the other sign (a compass turns clockwise)", lambda values: values * -1.0

    def change(self, by: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """The turn about the vertical."""
        return rotation[:, 2, None] @ by[:, :3]

    def covariance(self, of_pose: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        up = rotation[:, 2, :, None]
        return up.swapaxes(1, 2) @ of_pose[:, :3, :3] @ up

    def sensed(self, pose: Motion, cross_axis: float) -> np.ndarray:
        return read_angles(pose.rotation, cross_axis)["yaw"]


YAW = _Yaw()
