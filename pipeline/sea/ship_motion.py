"""The motion of a ship: attitude, rates and accelerations of every point on board."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.constants import g

from kincal.urdf.rigid_motion import cross, from_zyx_angles

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class ShipMotion:
    """n samples of a ship's motion about her mean course and speed; x forward, y to port, z up.

    t: (n,) [s]; position: (n, 3) surge, sway, heave of the ship's origin [m]; angles: (n, 3) roll, pitch, yaw of
    R = Rz(yaw) Ry(pitch) Rx(roll) [rad]: port side up, bow down, bow to port. And their time derivatives.
    """

    t: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    angles: np.ndarray
    angle_rates: np.ndarray  # [rad/s]
    angle_accelerations: np.ndarray  # [rad/s^2]

    def __len__(self) -> int:
        return len(self.t)

    @property
    def heave(self) -> np.ndarray:
        return self.position[:, 2]

    @property
    def roll(self) -> np.ndarray:
        return self.angles[:, 0]

    @property
    def pitch(self) -> np.ndarray:
        return self.angles[:, 1]

    @property
    def yaw(self) -> np.ndarray:
        return self.angles[:, 2]

    @cached_property
    def rotation(self) -> np.ndarray:
        """(n, 3, 3): ship to the mean frame."""
        return from_zyx_angles(self.angles[:, ::-1])

    @cached_property
    def angular_rate(self) -> np.ndarray:
        """(n, 3) in the ship's axes, as gyros on board read it [rad/s]; Fossen 2021, section 2.2."""
        (sr, cr), (sp, cp) = _sin_cos(self.roll), _sin_cos(self.pitch)
        roll, pitch, yaw = self.angle_rates.T
        return np.stack([roll - yaw * sp, pitch * cr + yaw * sr * cp, yaw * cr * cp - pitch * sr], axis=-1)

    @cached_property
    def angular_acceleration(self) -> np.ndarray:
        """(n, 3) in the ship's axes [rad/s^2]: the derivative of `angular_rate`."""
        (sr, cr), (sp, cp) = _sin_cos(self.roll), _sin_cos(self.pitch)
        (roll, pitch, yaw), (ddroll, ddpitch, ddyaw) = self.angle_rates.T, self.angle_accelerations.T
        return np.stack(
            [
                ddroll - ddyaw * sp - yaw * pitch * cp,
                ddpitch * cr + ddyaw * sr * cp - pitch * roll * sr + yaw * (roll * cr * cp - pitch * sr * sp),
                ddyaw * cr * cp - ddpitch * sr - pitch * roll * cr - yaw * (roll * sr * cp + pitch * cr * sp),
            ],
            axis=-1,
        )

    def acceleration_at(self, lever: ArrayLike) -> np.ndarray:
        """(n, 3) of a point of the ship, in the mean frame's axes [m/s^2]; lever: (3,) from the origin [m]."""
        w, arm = self.angular_rate, np.broadcast_to(np.asarray(lever, dtype=float), (len(self), 3))
        about = cross(self.angular_acceleration, arm) + cross(w, cross(w, arm))
        return self.acceleration + np.einsum("nij,nj->ni", self.rotation, about)

    def specific_force(self, lever: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
        """(n, 3) in the ship's axes, as accelerometers at a lever arm (3,) [m] read it [m/s^2]: + g upwards at rest."""
        return np.einsum("nji,nj->ni", self.rotation, self.acceleration_at(lever) + g * UP)

    def nmea_deg(self, course_deg: float = 0.0) -> np.ndarray:
        """(n, 3) roll, pitch, heading [deg] as NMEA sentences have them: port side up, bow up, clockwise from north."""
        heading = np.mod(course_deg - np.rad2deg(self.yaw), 360.0)
        return np.column_stack([np.rad2deg(self.roll), -np.rad2deg(self.pitch), heading])


def _sin_cos(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.sin(angle), np.cos(angle)
