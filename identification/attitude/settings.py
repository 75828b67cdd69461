"""What goes into the attitude filter and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.attitude.presets import PRESETS, SensorPreset
from kincal.urdf.errors import InputError


@dataclass(frozen=True)
class Samples:
    """n samples of sensors on the target, axes x forward, y to port, z up. A value that did not come is NaN.

    Either acceleration or tilt must be there: an inclinometer is an accelerometer that tells the direction alone.
    """

    acceleration: np.ndarray | None = None  # (n, 3) specific force [m/s2]: +g on z at rest
    gyro: np.ndarray | None = None  # (n, 3) [rad/s]
    tilt: np.ndarray | None = None  # (n, 2) roll, pitch [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)
    heading: np.ndarray | None = None  # (n,) yaw [rad]


@dataclass(frozen=True)
class WaveBand:
    """A seaway at first sight; the filter follows what it finds, unless it must not."""

    period_s: float = 8.0
    acceleration: float = 0.3  # horizontal, one sigma an axis [m/s2]
    damping: float = 0.3  # of each of the three oscillators: how wide the band is
    roll_pitch_deg: float = 3.0  # one sigma of the angles, used only without a gyro
    adaptive: bool = True


@dataclass(frozen=True)
class AttitudeSettings:
    """The filter's settings. waves: None for a target that is not accelerated."""

    sensor: SensorPreset = PRESETS["industrial"]
    waves: WaveBand | None = WaveBand()
    update_s: float = 0.25  # acceleration and heading are averaged so long; gyros are integrated at full rate
    start_s: float = 5.0  # whose median gives the start: one sample never does
    gate_probability: float = 1e-4  # of a good update to be taken for an outlier
    adapt_s: float = 60.0  # time constant of what the filter learns of waves and noise
    largest_gap_s: float = 0.5  # over a longer one the rates are not integrated: what they did is unknown
    rate_deg_s: float = 5.0  # one sigma of the target's rates, for such gaps


@dataclass(frozen=True)
class InnovationStatistics:
    """Normalised innovation squared of one channel, per degree of freedom: 1 where the model holds.

    inside: share of the updates within their own 95 % bound. whiteness: share of the first 20 autocorrelations of the
    innovations within theirs; lag_one: the first of them. band: what 95 % of means lie in, for as many independent
    innovations as the autocorrelation of their squares leaves (`effective`).
    """

    channel: str
    updates: int
    gated: int
    mean: float
    band: tuple[float, float]
    effective: float
    inside: float
    lag_one: float
    whiteness: float
    warning: str | None


@dataclass(frozen=True)
class AttitudeEstimate:
    """Attitude at n samples. Without a heading, yaw is what the gyro made of a start at 0."""

    roll_pitch_yaw: np.ndarray  # (n, 3) [rad]
    std: np.ndarray  # (n, 3) one sigma [rad]
    bias_free_std: np.ndarray  # (n, 2) of roll and pitch, but for the accelerometer's bias, which nothing on board sees
    gyro_bias: np.ndarray  # (n, 3) [rad/s]; zeros without a gyro
    acceleration_bias: np.ndarray  # (n, 3) [m/s2]
    acceleration: np.ndarray  # (n, 2) horizontal, along the axes of yaw = 0 [m/s2]
    innovations: tuple[InnovationStatistics, ...]


def check(t: np.ndarray, samples: Samples, settings: AttitudeSettings, source: str) -> None:
    """Raises InputError where times and samples are not what a filter can start from. `source` names their source."""
    n = len(t)
    if (samples.acceleration is None) == (samples.tilt is None):
        given = "neither" if samples.acceleration is None else "both"
        raise InputError(f"{source}: found {given} of acceleration and tilt; allowed is one of the two")
    columns = {"acceleration": 3, "gyro": 3, "tilt": 2, "heading": None}
    for name, width in columns.items():
        values = getattr(samples, name)
        shape = (n,) if width is None else (n, width)
        if values is not None and values.shape != shape:
            raise InputError(f"{source}: {name} has shape {values.shape}; allowed is {shape}, one row a time")
    if n < 2 or not np.isfinite(t).all() or not (np.diff(t) >= 0).all():
        raise InputError(f"{source}: {n} times; allowed are at least 2, finite, none before the one above it")
    force = samples.tilt if samples.acceleration is None else samples.acceleration
    assert force is not None
    early = force[t - t[0] <= settings.start_s]
    if not np.isfinite(early).all(axis=1).any():
        raise InputError(
            f"{source}: no good sample of tilt or acceleration in the first {settings.start_s:g} s; allowed is 1"
        )
    if t[-1] - t[0] < settings.start_s:
        raise InputError(f"{source}: {t[-1] - t[0]:.3g} s of samples; allowed are at least {settings.start_s:g} s")
