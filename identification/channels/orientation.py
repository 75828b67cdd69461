"""The whole orientation: a tracker's, a camera's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from kincal.identification.channels.channel import Channel, Mistake, Registered
from kincal.identification.channels.instrument import read_rotation
from kincal.identification.symbolic_chain import rotation_vector
from kincal.urdf.rigid_motion import Motion, exp, from_xyz_angles, log, xyz_angles

QUATERNION = ("qx", "qy", "qz", "qw")
EULER = ("rx", "ry", "rz")  # intrinsic XYZ [rad]
_LENGTH_TOLERANCE = 5e-3  # of a quaternion: three printed decimals


class _Orientation(Channel):
    """Values: rotations (n, 3, 3). Residual: the rotation vector from measured to predicted, in the target's frame."""

    name = "orientation"
    columns = QUATERNION
    column_unit = "1"
    unit = "rad"
    rows = 3
    size = 9
    parts = frozenset({"tilt", "yaw"})
    other_columns = (EULER,)
    tool_axes = frozenset({3, 4, 5})
    score_axes = "xyz"
    n_out = 3

    def canonical(self, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        if not all(c in columns for c in EULER):
            return columns
        others = {c: values for c, values in columns.items() if c not in EULER}
        euler = np.column_stack([columns[c] for c in EULER])
        return others if "qw" in columns else others | self.write(from_xyz_angles(euler))

    def wrong_row(self, columns: Mapping[str, np.ndarray]) -> tuple[int, str] | None:
        length = np.linalg.norm(np.column_stack([columns[c] for c in QUATERNION]), axis=1)
        bad = np.flatnonzero(np.abs(length - 1) > _LENGTH_TOLERANCE)
        return (int(bad[0]), f"the quaternion's length is {length[bad[0]]:.4g}; allowed is 1") if len(bad) else None

    def read(self, table: pd.DataFrame) -> np.ndarray:
        return Rotation.from_quat(super().read(table)).as_matrix()

    def write(self, values: np.ndarray) -> dict[str, np.ndarray]:
        return super().write(quaternions(values))

    def of(self, pose: Motion) -> np.ndarray:
        return pose.rotation

    def residual(self, rotation: ca.SX, translation: ca.SX, value: ca.SX) -> ca.SX:
        return rotation_vector(ca.reshape(value, 3, 3).T @ rotation)

    def observed(self, values: np.ndarray) -> np.ndarray:
        return super().observed(values.swapaxes(1, 2))

    def start_error(self, pose: Motion, values: np.ndarray) -> np.ndarray:
        return (pose.rotation - values) / np.sqrt(2)

    def moved(self, values: np.ndarray, before: Motion, after: Motion) -> np.ndarray:
        return values @ before.rotation.swapaxes(1, 2) @ after.rotation

    def mistakes(self) -> Iterator[Mistake]:
        for order, how in (([1, 2, 3, 0], "w, x, y, z"), ([3, 2, 1, 0], "w, z, y, x")):
            yield f"the columns qx, qy, qz, qw hold {how}", lambda r, order=order: _reordered(r, order)
        inverse = "the orientations are inverted (the instrument in the target's frame, or qw's sign)"
        yield inverse, lambda r: Motion(r, np.zeros((len(r), 3))).inverse().rotation

    def error(self, actual: Motion, predicted: Motion) -> np.ndarray:
        return orientation_error(actual.rotation, predicted.rotation)

    def change(self, by: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        return by[:, :3]

    def sensed(self, pose: Motion, cross_axis: float) -> np.ndarray:
        return read_rotation(pose.rotation, cross_axis)

    def noisy(self, values: np.ndarray, sigma: float, random: np.random.Generator) -> np.ndarray:
        return values @ exp(sigma * random.normal(size=(len(values), 3)))

    def outputs(self, robot: Registered, tool: Motion) -> np.ndarray:
        """Intrinsic XYZ angles of home orientation^T * orientation."""
        return xyz_angles(robot.chain.home_pose.rotation.T @ tool.rotation)

    def put(self, robot: Registered, y: np.ndarray, tool: Motion) -> Motion:
        return Motion(robot.chain.home_pose.rotation @ from_xyz_angles(y), tool.translation)


def orientation_error(actual: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(n, 3) [rad]: the rotation vector of R_actual^-1 R_predicted.

    For small errors the vector of its skew part (eq. 7 and 8), which it equals to third order; but half a turn is one.
    """
    return log(np.swapaxes(actual, -1, -2) @ predicted)


def quaternions(rotation: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions x, y, z, w of rotation matrices (n, 3, 3), with w >= 0."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True)


def _reordered(rotation: np.ndarray, order: list[int]) -> np.ndarray:
    return Rotation.from_quat(quaternions(rotation)[:, order]).as_matrix()


ORIENTATION = _Orientation()
