"""Tilt: an inclinometer's roll and pitch, which see the vertical and no turn about it."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.channels.channel import UP, Channel, Mistake, Registered
from kincal.identification.channels.instrument import read_angles
from kincal.identification.symbolic_chain import wrapped
from kincal.urdf.rigid_motion import Motion


class _Tilt(Channel):
    """Values: (n, 2) roll, pitch [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""

    name = "tilt"
    columns = ("roll", "pitch")
    column_unit = "rad"
    unit = "rad"
    rows = 2
    alone = "tilt alone: no turn about gravity is ever seen, neither the tool's nor W's; yaw stays unknown"
    score_axes = "xy"
    n_out = 2

    def of(self, pose: Motion) -> np.ndarray:
        r = pose.rotation
        return np.stack([np.arctan2(r[:, 2, 1], r[:, 2, 2]), -np.arcsin(np.clip(r[:, 2, 0], -1, 1))], axis=1)

    def residual(self, rotation: ca.SX, translation: ca.SX, value: ca.SX) -> ca.SX:
        roll = ca.atan2(rotation[2, 1], rotation[2, 2])
        pitch = -ca.atan2(rotation[2, 0], ca.sqrt(rotation[2, 1] ** 2 + rotation[2, 2] ** 2))
        return ca.vertcat(wrapped(roll - value[0]), wrapped(pitch - value[1]))

    def start_error(self, pose: Motion, values: np.ndarray) -> np.ndarray:
        return pose.rotation[:, 2] - vertical_in_target(values)

    def mistakes(self) -> Iterator[Mistake]:
        for how, matrix in (
            ("pitch has the other sign (NMEA: positive bow up)", [[1, 0], [0, -1]]),
            ("roll has the other sign", [[-1, 0], [0, 1]]),
            ("roll and pitch are swapped", [[0, 1], [1, 0]]),
        ):
            yield how, lambda values, matrix=matrix: values @ np.array(matrix, dtype=float)

    def error(self, actual: Motion, predicted: Motion) -> np.ndarray:
        return gravity_error(actual.rotation, predicted.rotation)

    def change(self, by: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Rotation vectors, the turn about the vertical taken off."""
        up, turned = rotation[:, 2], by[:, :3]
        return turned - up[:, :, None] * np.einsum("ni,nij->nj", up, turned)[:, None]

    def covariance(self, of_pose: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        up = rotation[:, 2]
        flat = np.eye(3) - up[:, :, None] * up[:, None]
        return flat @ of_pose[:, :3, :3] @ flat

    def sensed(self, pose: Motion, cross_axis: float) -> np.ndarray:
        angles = read_angles(pose.rotation, cross_axis)
        return np.stack([angles["roll"], angles["pitch"]], axis=1)

    def outputs(self, robot: Registered, tool: Motion) -> np.ndarray:
        """Two coordinates of the vertical seen from the tool, turned so that home's is (0, 0, 1)."""
        return _vertical(robot, tool.rotation.swapaxes(1, 2) @ _up(robot))

    def measured_outputs(self, robot: Registered, values: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        return _vertical(robot, vertical_in_target(values) @ robot.target.rotation.T)

    def put(self, robot: Registered, y: np.ndarray, tool: Motion) -> Motion:
        return Motion(_tilted(robot, tool.rotation, y), tool.translation)


def gravity_error(actual: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(n, 3) [rad]: as `orientation_error`, between the verticals alone; what tilt can tell. About z: 0 at level.

    The vertical in the tool's frame is the orientation's third row; the error is the smallest rotation between the two.
    """
    first, second = actual[..., 2, :], predicted[..., 2, :]
    axis = np.cross(second, first)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = np.sum(first * second, axis=-1, keepdims=True)
    return axis * np.where(sine > 1e-12, np.arctan2(sine, cosine) / np.maximum(sine, 1e-12), 1.0)


def vertical_in_target(tilt: np.ndarray) -> np.ndarray:
    """(n, 3): the vertical in the target's frame, the third row of its orientation. tilt: (n, 2) roll, pitch."""
    roll, pitch = tilt.T
    return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)


def _up(robot: Registered) -> np.ndarray:
    """The vertical in the base frame."""
    return robot.instrument.rotation.T @ UP


def _to_home(robot: Registered) -> np.ndarray:
    """The turn that brings the vertical seen from the tool at home to (0, 0, 1)."""
    vertical = robot.chain.home_pose.rotation.T @ _up(robot)
    return Rotation.align_vectors(UP[None], vertical[None])[0].as_matrix()


def _vertical(robot: Registered, seen: np.ndarray) -> np.ndarray:
    return (seen @ _to_home(robot).T)[:, :2]


def _tilted(robot: Registered, rotation: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The orientations nearest to `rotation` (n, 3, 3) that see the vertical where y says."""
    upright = np.sqrt(np.maximum(1 - np.sum(y**2, axis=1, keepdims=True), 0.0))
    wanted = np.concatenate([y, upright], axis=1) @ _to_home(robot)
    seen = rotation.swapaxes(1, 2) @ _up(robot)
    axis = np.cross(wanted, seen)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, np.sum(wanted * seen, axis=1, keepdims=True))
    turn = Rotation.from_rotvec(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)).as_matrix()
    return rotation @ turn


TILT = _Tilt()
