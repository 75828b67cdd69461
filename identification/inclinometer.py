"""Raw inclinometer streams -> one attitude a static pose: an extended Kalman filter (filterpy) over each stretch.

State: roll, pitch and, with a heading reference, yaw of the target [rad], held still but for a slow drift. The
inclinometer and the heading reference are updates of their own, so that an outlier of one costs nothing of the other.
Outliers are gated by the Mahalanobis distance of the innovation. The filter starts diffuse; what an outlier is, as long
as it knows nothing, a robust window tells (its median): a single sample never decides.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import chdtri

from identification.measurements import UNITS
from urdf.description import Filter, Sensor
from urdf.errors import InputError

CHANNELS = ("roll", "pitch", "yaw")
_SENSORS = ((0, 1), (2,))  # an inclinometer's roll and pitch, and a heading reference: each is gated by itself
_DIFFUSE = 10.0  # one sigma of the state before the first sample [rad]
_STUCK = 10  # samples: fewer may well be alike
_MEDIAN = 0.67449  # of the absolute value of a standard normal variable


@dataclass(frozen=True)
class StaticAttitude:
    """One pose's attitude: angles (k,) [rad] with covariance (k, k), k = 2, or 3 with a heading."""

    angles: np.ndarray
    covariance: np.ndarray
    used: int
    gated: int


def _sample_sigma(sensor: Sensor, channel: str, stretches: Iterable[pd.DataFrame]) -> float:
    """One sigma of a sample [rad]: as given, else from the median difference within poses, which outliers spare."""
    kind = "yaw" if channel == "yaw" else "tilt"
    if sensor.given(kind):
        return sensor.sigma(kind)
    differences = np.abs(np.concatenate([np.diff(part[channel].to_numpy(float)) for part in stretches]))
    differences = differences[np.isfinite(differences)]
    estimate = float(np.median(differences)) / (np.sqrt(2) * _MEDIAN) if len(differences) else 0.0
    return estimate or sensor.sigma(kind)


def filter_stream(stream: pd.DataFrame, poses: np.ndarray, sensor: Sensor, settings: Filter, what: str) -> pd.DataFrame:
    """One row a pose of `poses` (n,): roll, pitch, tilt_std [rad] (and yaw, yaw_std), used and gated samples.

    `what` names the stream in messages. Raises InputError for a pose without samples, and for a stuck channel.
    """
    channels = [c for c in CHANNELS if c in stream]
    grouped = dict(iter(stream.groupby("pose", sort=False)))
    sigma = np.array([_sample_sigma(sensor, c, grouped.values()) for c in channels])
    rows = []
    for pose in poses:
        part = grouped.get(pose)
        if part is None:
            raise InputError(f"{what}: pose {pose} has no sample; allowed is at least {settings.min_samples}")
        samples = part[channels].to_numpy(float)
        _check(samples, channels, int(pose), settings, what)
        found = static_attitude(part["t"].to_numpy(float), samples, sigma, settings)
        if found.used < max(settings.min_samples, found.gated):
            raise InputError(
                f"{what}: pose {pose}: {found.gated} of {len(samples)} samples are outliers; "
                f"allowed are fewer than half, and at least {settings.min_samples} good samples"
            )
        variance = np.diag(found.covariance)
        row = {
            "pose": int(pose),
            "roll": found.angles[0],
            "pitch": found.angles[1],
            "tilt_std": np.sqrt(variance[:2].mean()),
        }
        if "yaw" in channels:
            row |= {"yaw": found.angles[2], "yaw_std": np.sqrt(variance[2])}
        rows.append(row | {"used": found.used, "gated": found.gated})
    return pd.DataFrame(rows)


def static_attitude(t: np.ndarray, samples: np.ndarray, sigma: np.ndarray, settings: Filter) -> StaticAttitude:
    """The attitude behind one pose's samples (n, k) [rad] at times t (n,) [s]; sigma (k,): a sample's noise [rad]."""
    from filterpy.kalman import ExtendedKalmanFilter  # imports matplotlib: a second

    k = samples.shape[1]
    ekf = ExtendedKalmanFilter(dim_x=k, dim_z=k)
    ekf.x = samples[0].copy()  # a diffuse state: where it stands does not matter, but for the wrap-around
    ekf.P = np.eye(k) * _DIFFUSE**2
    eye, noise, drift = np.eye(k), sigma**2, np.deg2rad(settings.drift_deg_per_sqrt_s) ** 2
    gates = {part: float(chdtri(len(part), settings.gate_probability)) for part in _SENSORS if part[-1] < k}
    window = _centre(samples[: settings.window])
    used, gated, last = 0, 0, t[0]
    for time, sample in zip(t, samples, strict=True):
        ekf.Q = eye * (drift * (time - last))
        ekf.predict()
        last = time
        variance = np.diag(ekf.P)
        known = variance < noise  # until then the window's median is the better reference
        innovation = _wrap(sample - np.where(known, ekf.x, window))
        distance = innovation**2 / (noise + np.where(known, variance, noise / 4))
        good = [i for part, gate in gates.items() if sum(distance[i] for i in part) <= gate for i in part]
        used, gated = used + (len(good) == k), gated + (len(good) < k)
        if good:
            h = eye[good]
            ekf.update(
                sample[good], lambda x, h=h: h, lambda x, h=h: h @ x, R=np.diag(noise[good]), residual=_difference
            )
    return StaticAttitude(_wrap(ekf.x), ekf.P, used, gated)


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _wrap(a - b)


def _wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _centre(samples: np.ndarray) -> np.ndarray:
    """(k,) the median of angles, about the first sample: they may lie on both sides of +-180 degrees."""
    return samples[0] + np.median(_wrap(samples - samples[0]), axis=0)


def _check(samples: np.ndarray, channels: list[str], pose: int, settings: Filter, what: str) -> None:
    if len(samples) < settings.min_samples:
        raise InputError(f"{what}: pose {pose} has {len(samples)} samples; allowed is at least {settings.min_samples}")
    for channel, values in zip(channels, samples.T, strict=True):
        if len(values) >= _STUCK and np.ptp(values) == 0:
            raise InputError(
                f"{what}: pose {pose}: channel {channel!r} is stuck at {values[0] / UNITS['deg']:.6g} degrees "
                f"for all {len(values)} samples; allowed is a sensor that moves with its noise"
            )
