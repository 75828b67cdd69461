"""From a ship's attitude to what the platform is asked for, and from commands to where its actuators are."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter, lfiltic

from kincal.urdf.rigid_motion import exp, from_zyx_angles, zyx_angles


def levelling(angles: np.ndarray, yaw: float) -> np.ndarray:
    """(n, 3, 3): the deck's orientation on board that is level, and turned by `yaw` [rad] from the ship's heading.

    angles: (n, >= 2) roll, pitch of the ship [rad]; her own heading is not held against.
    """
    tilt = from_zyx_angles(np.stack([np.zeros(len(angles)), angles[:, 1], angles[:, 0]], axis=1))
    return tilt.swapaxes(1, 2) @ from_zyx_angles(np.array([yaw, 0.0, 0.0]))


def ahead(angles: np.ndarray, rate: np.ndarray, seconds: float) -> np.ndarray:
    """(n, 3) roll, pitch, yaw [rad] some seconds later, at the rates (n, 3) in the ship's axes [rad/s] of now."""
    turned = from_zyx_angles(angles[:, ::-1]) @ exp(seconds * rate)
    return zyx_angles(turned)[:, ::-1]


def late(values: np.ndarray, samples: int) -> np.ndarray:
    """Values (n, ...) that come so many samples later; the first one stands until then."""
    if not samples:
        return values
    return np.concatenate([np.repeat(values[:1], min(samples, len(values)), axis=0), values[:-samples]])[: len(values)]


def followed(commands: np.ndarray, keep: float) -> np.ndarray:
    """Where actuators are that follow commands (n, k) by a first-order lag which keeps this share a sample."""
    if not keep:
        return commands
    state = lfiltic([1 - keep], [1.0, -keep], y=[1.0])
    return lfilter([1 - keep], [1.0, -keep], commands, axis=0, zi=state[:, None] * commands[0])[0]


def kept(bandwidth_hz: float, rate_hz: float) -> float:
    """The share that a lag of this bandwidth keeps from one sample to the next."""
    return float(np.exp(-2 * np.pi * bandwidth_hz / rate_hz))


def lag(keep: float, rate_hz: float) -> float:
    """By how many seconds `followed` is behind a ramp."""
    return keep / (1 - keep) / rate_hz
