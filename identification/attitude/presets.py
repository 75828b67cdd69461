"""Sensor classes by their data sheets' typical figures; docs/explanation/attitude.md names the families."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from kincal.urdf.description import nearest
from kincal.urdf.errors import InputError, quoted

_DEG, _MILLI_G = np.pi / 180, 1e-3 * g


@dataclass(frozen=True)
class SensorPreset:
    """What one class of sensors gets wrong. Bias: unknown within *_bias at switch-on, wandering by *_instability.

    An instability is the floor of the Allan deviation, a wander with correlation time `instability_s` [s].
    """

    name: str
    rate_hz: float  # at which it is usually logged
    gyro_noise: float  # white, one sigma [rad/s/sqrt(Hz)]
    gyro_bias: float  # one sigma at switch-on [rad/s]
    gyro_instability: float  # [rad/s]
    acceleration_noise: float  # [m/s2/sqrt(Hz)]
    acceleration_bias: float  # one sigma at switch-on and over temperature, after calibration [m/s2]
    acceleration_instability: float  # [m/s2]
    tilt_noise: float  # of a roll or pitch channel, one sigma a sample at rate_hz [rad]
    tilt_bias: float  # [rad]
    heading_noise: float  # one sigma a sample at rate_hz [rad]
    instability_s: float = 100.0


PRESETS = {
    preset.name: preset
    for preset in (
        SensorPreset(
            name="precision",  # electrolytic or force-balance inclinometer; tactical-grade gyro and accelerometer
            rate_hz=50.0,
            gyro_noise=0.15 * _DEG / 60,  # 0.15 deg/sqrt(h)
            gyro_bias=10.0 * _DEG / 3600,
            gyro_instability=0.5 * _DEG / 3600,
            acceleration_noise=0.1 * _MILLI_G,
            acceleration_bias=0.75 * _MILLI_G,
            acceleration_instability=0.05 * _MILLI_G,
            tilt_noise=0.002 * _DEG,
            tilt_bias=0.003 * _DEG,
            heading_noise=0.1 * _DEG,
        ),
        SensorPreset(
            name="industrial",  # MEMS inclinometer; industrial MEMS inertial unit
            rate_hz=50.0,
            gyro_noise=0.005 * _DEG,
            gyro_bias=0.05 * _DEG,
            gyro_instability=8.0 * _DEG / 3600,
            acceleration_noise=0.12 * _MILLI_G,
            acceleration_bias=2.0 * _MILLI_G,
            acceleration_instability=0.04 * _MILLI_G,
            tilt_noise=0.01 * _DEG,
            tilt_bias=0.05 * _DEG,
            heading_noise=0.5 * _DEG,
        ),
        SensorPreset(
            name="mru",  # motion reference unit of a vessel: calibrated, low-noise MEMS
            rate_hz=100.0,
            gyro_noise=0.0025 * _DEG,
            gyro_bias=0.01 * _DEG,
            gyro_instability=2.0 * _DEG / 3600,
            acceleration_noise=0.07 * _MILLI_G,
            acceleration_bias=0.3 * _MILLI_G,
            acceleration_instability=0.013 * _MILLI_G,
            tilt_noise=0.005 * _DEG,
            tilt_bias=0.02 * _DEG,
            heading_noise=0.2 * _DEG,
        ),
    )
}


def preset(name: str) -> SensorPreset:
    """The preset of a name. Raises InputError that names the nearest one."""
    if name not in PRESETS:
        raise InputError(f"sensor preset {quoted(name)} is unknown; {nearest(name, list(PRESETS))}")
    return PRESETS[name]
