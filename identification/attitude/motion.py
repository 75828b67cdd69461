"""The nominal state of the attitude filter, and how it and its errors move on over a block.

The attitude's error d is in the level frame, true R = exp(d) R: there gravity always pulls the same way.

    d' = d - R dt (error of the gyro's bias) + noise            with a gyro
    d' = d + (change of the swing's angles) + noise             without one: the swing is a wave-band model

Biases are first-order Gauss-Markov processes as wide as the bias at switch-on; how they begin to wander is the
sensor's instability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, exp, sin, sqrt

import numpy as np

from kincal.identification.attitude import wave_band
from kincal.identification.attitude.settings import AttitudeSettings
from kincal.urdf.rigid_motion import log

_MEAN_ANGLE = np.deg2rad(1e-3)  # what a mean angle may do without a gyro to tell [rad/sqrt(s)]


@dataclass(frozen=True)
class Layout:
    """Where the errors stand: attitude, rates (the gyro's bias, or angle and rate of the swing), bias, waves."""

    gyro: bool
    rates: slice
    bias: slice
    band: slice  # empty where the target is not accelerated

    @staticmethod
    def of(settings: AttitudeSettings, gyro: bool) -> Layout:
        bias = 6 if gyro else 9
        waves = 0 if settings.waves is None else 2 * wave_band.ORDER
        return Layout(gyro, slice(3, bias), slice(bias, bias + 3), slice(bias + 3, bias + 3 + waves))

    @property
    def size(self) -> int:
        return self.band.stop

    @property
    def axes(self) -> tuple[slice, slice]:
        """Of the waves, where there are any."""
        first, second = self.band.start, self.band.start + wave_band.ORDER
        return slice(first, second), slice(second, second + wave_band.ORDER)


@dataclass(frozen=True)
class Sea:
    """The wave band as it is known by now."""

    period: float  # [s]
    acceleration: float  # one sigma [m/s2]
    damping: float


@dataclass(frozen=True)
class Nominal:
    rotation: np.ndarray  # (3, 3) target to level frame
    gyro_bias: np.ndarray  # (3,) [rad/s]
    swing: np.ndarray  # (2, 3) angles about their mean [rad] and rates [rad/s], without a gyro
    bias: np.ndarray  # (3,) of the acceleration [m/s2]
    wave: np.ndarray  # (2, 6) displacement of x and y and its derivatives [m, m/s, ..]

    @property
    def acceleration(self) -> np.ndarray:
        return self.wave[:, wave_band.ACCELERATION]

    def errors(self, true: Nominal, layout: Layout) -> np.ndarray:
        """(size,) what `corrected` takes to get from here to a true state."""
        rates = true.gyro_bias - self.gyro_bias if layout.gyro else (true.swing - self.swing).ravel()
        wave = (true.wave - self.wave).ravel()[: layout.size - layout.band.start]
        return np.concatenate([log(true.rotation @ self.rotation.T), rates, true.bias - self.bias, wave])

    def corrected(self, error: np.ndarray, layout: Layout) -> Nominal:
        """With the errors (size,) put right."""
        rates = error[layout.rates]
        return Nominal(
            rotation_of(error[:3]) @ self.rotation,
            self.gyro_bias + rates if layout.gyro else self.gyro_bias,
            self.swing if layout.gyro else self.swing + rates.reshape(2, 3),
            self.bias + error[layout.bias],
            self.wave + error[layout.band].reshape(2, -1) if layout.band.stop > layout.band.start else self.wave,
        )


@dataclass(frozen=True)
class Moved:
    """Over a block: nominal state at its end and, without a gyro, the turn in the level frame (3,) [rad]."""

    nominal: Nominal
    turn: np.ndarray
    transition: np.ndarray  # (size, size) of the errors
    noise: np.ndarray


def move(
    nominal: Nominal,
    steady: np.ndarray,
    dt: float,
    gap: float,
    rotation: np.ndarray,
    sea: Sea | None,
    layout: Layout,
    settings: AttitudeSettings,
) -> Moved:
    """Over dt [s], `gap` of it with unknown rates, turned by `rotation` (3,) [rad] as the gyro has it.

    steady: (3, 3) the attitude at which the errors' model is taken.
    """
    s = settings.sensor
    f, q, turn = np.eye(layout.size), np.zeros((layout.size, layout.size)), np.zeros(3)
    eye = np.eye(3)
    if layout.gyro:
        keep, gathered = _wandering(s.gyro_bias, s.gyro_instability, s.instability_s, dt)
        f[:3, 3:6], f[3:6, 3:6] = -dt * steady, keep * eye
        q[:3, :3], q[3:6, 3:6] = s.gyro_noise**2 * dt * eye, gathered * eye
        turned = nominal.rotation @ rotation_of(rotation - (dt - gap) * nominal.gyro_bias)
        gyro_bias, swing = keep * nominal.gyro_bias, nominal.swing
    else:
        model = swing_model(settings, dt)
        f[3:9, 3:9], q[3:9, 3:9] = np.kron(model.transition, eye), np.kron(model.noise, eye)
        f[:3, 3:9] = f[3:6, 3:9] - np.eye(3, 6)
        q[:3, 3:9], q[3:9, :3] = q[3:6, 3:9], q[3:9, 3:6]
        q[:3, :3] = q[3:6, 3:6] + _MEAN_ANGLE**2 * dt * eye
        swing = model.transition @ nominal.swing
        turn = swing[0] - nominal.swing[0]
        turned, gyro_bias = rotation_of(turn) @ nominal.rotation, nominal.gyro_bias
    q[:3, :3] += (np.deg2rad(settings.rate_deg_s) * gap) ** 2 * eye
    keep, gathered = _wandering(s.acceleration_bias, s.acceleration_instability, s.instability_s, dt)
    f[layout.bias, layout.bias], q[layout.bias, layout.bias] = keep * eye, gathered * eye
    wave = nominal.wave
    if sea is not None:
        model = wave_model(sea, dt)
        for axis in layout.axes:
            f[axis, axis], q[axis, axis] = model.transition, model.noise
        wave = wave @ model.transition.T
    return Moved(Nominal(turned, gyro_bias, swing, keep * nominal.bias, wave), turn, f, q)


@lru_cache(maxsize=64)
def wave_model(sea: Sea, dt: float) -> wave_band.Discrete:
    return wave_band.displacement(sea.period, sea.acceleration, sea.damping, dt)


def swing_model(settings: AttitudeSettings, dt: float) -> wave_band.Discrete:
    """Of a target without a gyro; one that no waves move hardly turns."""
    waves = settings.waves
    if waves is None:
        return wave_band.angle(8.0, np.deg2rad(1e-3), 0.3, dt)
    return wave_band.angle(waves.period_s, np.deg2rad(waves.roll_pitch_deg), waves.damping, dt)


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """(3, 3) of one rotation vector (3,) [rad]: Rodrigues' formula; scipy's batches cost ten times as much for one."""
    x, y, z = vector.tolist()
    square = x * x + y * y + z * z
    angle = sqrt(square)
    if angle < 1e-4:
        s, c = 1 - square / 6, 0.5 - square / 24
    else:
        s, c = sin(angle) / angle, (1 - cos(angle)) / square
    return np.array(
        [
            [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)],
        ]
    )


def _wandering(sigma: float, instability: float, time: float, dt: float) -> tuple[float, float]:
    """Transition and noise of a Gauss-Markov process of stationary sigma that starts out as a random walk.

    The walk is that of a process of sigma `instability` and correlation time `time`: density 2 instability^2 / time.
    """
    keep = exp(-dt * instability**2 / (sigma**2 * time)) if sigma > 0 else 1.0
    return keep, sigma**2 * (1 - keep**2)
