"""A vessel's motion in a seaway for benchmarks: sums of harmonics, so that angles, rates and accelerations agree.

The seam: whatever gives a `VesselMotion` can stand in for `sea_state`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from urdf.rigid_motion import from_zyx_angles

GRAVITY = 9.80665
SEA_STATES = {3: (0.88, 7.5), 4: (1.88, 8.8), 5: (3.25, 9.7), 6: (5.0, 12.4)}  # height [m], peak period [s]: NATO, open


@dataclass(frozen=True)
class VesselMotion:
    """At n times [s], axes x forward, y to port, z up."""

    t: np.ndarray
    roll_pitch_yaw: np.ndarray  # (n, 3) [rad]
    body_rates: np.ndarray  # (n, 3) [rad/s]
    acceleration: np.ndarray  # (n, 3) of the sensor in the level frame of yaw = 0 [m/s2]

    def specific_force(self) -> np.ndarray:
        """(n, 3) what an ideal accelerometer reads [m/s2]."""
        rotation = from_zyx_angles(self.roll_pitch_yaw[:, ::-1])
        return np.einsum("nji,nj->ni", rotation, self.acceleration + np.array([0.0, 0.0, GRAVITY]))


def jonswap(frequency: np.ndarray, height: float, period: float, peakedness: float = 3.3) -> np.ndarray:
    """(k,) wave spectrum [m2 s / rad] at angular frequencies [rad/s], scaled to the significant height [m]."""
    peak = 2 * np.pi / period
    width = np.where(frequency <= peak, 0.07, 0.09)
    bump = peakedness ** np.exp(-((frequency - peak) ** 2) / (2 * width**2 * peak**2))
    shape = frequency**-5.0 * np.exp(-1.25 * (peak / frequency) ** 4) * bump
    return shape * (height / 4) ** 2 / np.trapezoid(shape, frequency)


def sea_state(
    state: int, seconds: float, rate_hz: float, seed: int, length: float = 90.0, heading_deg: float = 120.0
) -> VesselMotion:
    """Of a ship `length` [m] long; waves from heading_deg (180 is ahead). Lateral acceleration as its sensors feel it.

    The responses are simple ones: short waves fade (exp of minus the square of wave number times a quarter length),
    roll resonates at 11 s with a twelfth of critical damping, pitch and heave follow the slope and the height.
    """
    random = np.random.default_rng([seed, 21])
    w = np.linspace(0.25, 3.0, 400) + random.uniform(-0.5, 0.5, 400) * (2.75 / 399)
    amplitude = np.sqrt(2 * jonswap(w, *SEA_STATES[state]) * 2.75 / 399)
    phase = random.uniform(0, 2 * np.pi, len(w))
    angle, number = np.deg2rad(heading_deg), w**2 / GRAVITY
    fade = np.exp(-((number * length / 4 * np.cos(angle)) ** 2)) * np.exp(-((number * 8.0 * np.sin(angle)) ** 2))
    own = w / (2 * np.pi / 11.0)
    resonance = 1 / (1 - own**2 + 2j * 0.085 * own)
    wave = amplitude * np.exp(1j * phase)
    responses = {
        "surge": -1j * fade * np.cos(angle) * 0.9,
        "sway": 1j * fade * np.sin(angle) * 0.9,
        "heave": fade + 0j,
        "roll": 1j * 0.35 * number * fade * np.sin(angle) * resonance,
        "pitch": 1j * 0.7 * number * fade * np.cos(angle),
        "yaw": 0.15 * number * fade * np.sin(2 * angle) + 0j,
    }
    t = np.arange(0.0, seconds, 1 / rate_hz)
    turns = np.exp(1j * np.outer(t, w))

    def series(name: str, derivative: int = 0) -> np.ndarray:
        return (turns @ (responses[name] * wave * (1j * w) ** derivative)).real

    angles = np.stack([series("roll"), series("pitch"), series("yaw")], axis=1)
    rates = np.stack([series("roll", 1), series("pitch", 1), series("yaw", 1)], axis=1)
    acceleration = np.stack([series(name, 2) for name in ("surge", "sway", "heave")], axis=1)
    return VesselMotion(t, angles, body_rates(angles, rates), acceleration)


def body_rates(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(n, 3) angular velocity in the body of roll, pitch, yaw (n, 3) and their derivatives (n, 3)."""
    (roll, pitch, _), (p, q, r) = angles.T, rates.T
    return np.stack(
        [
            p - np.sin(pitch) * r,
            np.cos(roll) * q + np.sin(roll) * np.cos(pitch) * r,
            -np.sin(roll) * q + np.cos(roll) * np.cos(pitch) * r,
        ],
        axis=1,
    )
