"""A sensor_msgs/Imu as an attitude: by its orientation, or as an inclinometer by its accelerometer.

Many drivers never set the orientation: it is zero, or says level in every message. Its variance tells: a tilt that
never changes though the accelerometer's does is none.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

_STILL = 1e-9  # of a direction's components: less is no change
_LEAST = 10  # messages: of fewer no variance tells
_NEVER = (
    "roll and pitch of the orientation never change, those of the accelerometer do; kincal used the accelerometer "
    "(measure.log.orientation = true uses the orientation)"
)


@dataclass(frozen=True)
class Orientation:
    """What of the messages' orientation is used."""

    tilt: bool
    yaw: bool
    note: str = ""


def orientation_of(messages: Iterable[Any], setting: bool | None) -> Orientation:
    """As measure.log.orientation says; None: as the messages tell. They are read up to the first tilt that changed."""
    if setting is not None:
        return Orientation(setting, setting)
    changes, known, read = _Changes(), 0, 0
    for message in messages:
        q, a = message.orientation, message.linear_acceleration
        read += 1
        changes.add("acceleration", np.array([a.x, a.y, a.z]))
        if is_known(message):
            known += 1
            for name, direction in _directions(np.array([q.x, q.y, q.z, q.w])).items():
                changes.add(name, direction)
        if "up" in changes.names:
            return Orientation(tilt=True, yaw=True)
    if known == 0 < read:
        return Orientation(False, False, "its messages have no orientation; kincal used the accelerometer")
    if known < _LEAST or "acceleration" not in changes.names:
        return Orientation(tilt=True, yaw=True)
    return Orientation(False, "forward" in changes.names, _NEVER)


@dataclass
class _Changes:
    """Names of the directions that were not always the same."""

    first: dict[str, np.ndarray] = field(default_factory=dict)
    names: set[str] = field(default_factory=set)

    def add(self, name: str, vector: np.ndarray) -> None:
        """One more value; a vector without a direction (zero, not finite) is none."""
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            direction = vector / np.linalg.norm(vector)
        if not np.all(np.isfinite(direction)):
            return
        if np.max(np.abs(direction - self.first.setdefault(name, direction))) > _STILL:
            self.names.add(name)


def is_known(message: Any) -> bool:
    """Whether a message says itself that it has an orientation: no -1 in its covariance, a quaternion that is not 0."""
    q = message.orientation
    size = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    return bool(message.orientation_covariance[0] != -1 and 0 < size < np.inf)


def imu_row(message: Any) -> tuple[float, ...]:
    """Quaternion x, y, z, w (NaN where it is unknown), rates and accelerations."""
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    quaternion = (q.x, q.y, q.z, q.w) if is_known(message) else (np.nan,) * 4
    return (*quaternion, w.x, w.y, w.z, a.x, a.y, a.z)


def imu_chunk(rows: np.ndarray, orientation: Orientation) -> pd.DataFrame:
    """t, roll, pitch, yaw, gyro_x..z, acc_x..z of rows (n, 11): t [s], then those of `imu_row`."""
    with np.errstate(invalid="ignore", over="ignore"):  # a message's numbers may be any
        x, y, z, w = rows[:, 1:5].T / np.linalg.norm(rows[:, 1:5], axis=1)
        acceleration = np.where(np.any(rows[:, 8:11] != 0, axis=1)[:, None], rows[:, 8:11], np.nan)
        ax, ay, az = acceleration.T
        level = np.isnan(w) if orientation.tilt else np.ones(len(w), dtype=bool)
        roll = np.where(level, np.arctan2(ay, az), np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
        pitch = np.where(level, np.arctan2(-ax, np.hypot(ay, az)), np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)))
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    columns = {"t": rows[:, 0], "roll": roll, "pitch": pitch, "yaw": yaw if orientation.yaw else np.nan}
    names = (f"{sensor}_{axis}" for sensor in ("gyro", "acc") for axis in "xyz")
    return pd.DataFrame(columns | dict(zip(names, rows[:, 5:11].T, strict=True)))


def _directions(q: np.ndarray) -> dict[str, np.ndarray]:
    """The vertical in the sensor's axes, and the sensor's x axis in the world's; not normed, as the quaternion."""
    x, y, z, w = q
    with np.errstate(invalid="ignore", over="ignore"):
        up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])
        forward = np.array([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)])
    return {"up": up, "forward": forward}
