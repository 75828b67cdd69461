"""How an instrument whose axes leak into each other reads an orientation."""

from __future__ import annotations

import numpy as np

from kincal.urdf.rigid_motion import exp, log

_LEAK = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # from roll, pitch, yaw into each of them


def read_angles(rotation: np.ndarray, cross_axis: float) -> dict[str, np.ndarray]:
    """Roll, pitch and yaw (n) [rad] of Rz(yaw) Ry(pitch) Rx(roll) as an inclinometer reads rotations (n, 3, 3)."""
    r = rotation
    roll, pitch = np.arctan2(r[:, 2, 1], r[:, 2, 2]), -np.arcsin(r[:, 2, 0])
    angles = np.stack([roll, pitch, np.arctan2(r[:, 1, 0], r[:, 0, 0])])
    return dict(zip(("roll", "pitch", "yaw"), angles + cross_axis * _LEAK @ angles, strict=True))


def read_rotation(rotation: np.ndarray, cross_axis: float) -> np.ndarray:
    """Rotations (n, 3, 3) as a tracker reads them: its axes leak what has turned since the first pose."""
    if not cross_axis or not len(rotation):
        return rotation  # to the bit
    first = rotation[0]
    return first @ exp(log(first.T @ rotation) @ (np.eye(3) + cross_axis * _LEAK).T)
