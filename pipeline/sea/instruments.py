"""What inertial sensors on a moving body say: white noise, a bias of switch-on, and its slow wander."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from kincal.identification.attitude.presets import SensorPreset
from kincal.identification.attitude.settings import Samples


@dataclass(frozen=True)
class Sensed:
    """What sensors say, and what nobody on board knows: the accelerometers' bias at switch-on (3,) [m/s2]."""

    samples: Samples
    bias: np.ndarray


def sensed(force: np.ndarray, rate: np.ndarray, rate_hz: float, sensor: SensorPreset, seed: list[int]) -> Sensed:
    """Accelerometers and gyros on true specific force (n, 3) [m/s2] and angular rate (n, 3) [rad/s] in their axes."""
    random = np.random.default_rng(seed)
    force_error, bias = _errors(
        random,
        len(force),
        rate_hz,
        (sensor.acceleration_noise, sensor.acceleration_bias, sensor.acceleration_instability, sensor.instability_s),
    )
    rate_error, _ = _errors(
        random,
        len(rate),
        rate_hz,
        (sensor.gyro_noise, sensor.gyro_bias, sensor.gyro_instability, sensor.instability_s),
    )
    return Sensed(Samples(acceleration=force + force_error, gyro=rate + rate_error), bias)


def _errors(
    random: np.random.Generator, n: int, rate_hz: float, size: tuple[float, float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) of a noise density, a bias' sigma, and a first-order Gauss-Markov wander of sigma and correlation time.

    And the bias (3,) in it.
    """
    density, bias, instability, time = size
    keep = np.exp(-1 / (rate_hz * time))
    steps = random.normal(size=(n, 3)) * instability * np.sqrt(1 - keep**2)
    wander = lfilter([1.0], [1.0, -keep], steps, axis=0)
    offset = bias * random.normal(size=3)
    return offset + wander + density * np.sqrt(rate_hz) * random.normal(size=(n, 3)), offset
