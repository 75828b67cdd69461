"""Samples of a target held still -> its attitude: an extended Kalman filter, one pose (filterpy) or all at once.

State: roll, pitch and, with a heading reference, yaw of the target [rad], held still but for a slow drift. The
inclinometer and the heading reference are updates of their own, so that an outlier of one costs nothing of the other.
Outliers are gated by the Mahalanobis distance of the innovation. The filter starts diffuse; what an outlier is, as long
as it knows nothing, a robust window tells (its median): a single sample never decides.

All channels are measured directly and their noise is independent, so the covariance stays diagonal: the batch steps
every pose and channel as a scalar, in the order of filterpy's operations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from kincal.urdf.description import Filter

_SENSORS = ((0, 1), (2,))  # an inclinometer's roll and pitch, and a heading reference: each is gated by itself
_DIFFUSE = 10.0  # one sigma of the state before the first sample [rad]
_FINEST = 1e-12  # [rad] of noise: less is none, and would be divided by


@dataclass(frozen=True)
class StaticAttitude:
    """One pose's attitude: angles (k,) [rad] with covariance (k, k), k = 2, or 3 with a heading."""

    angles: np.ndarray
    covariance: np.ndarray
    used: int
    gated: int


@dataclass(frozen=True)
class StaticAttitudes:
    """Attitudes of n poses: angles (n, k) [rad], their variances (n, k) [rad2], used and gated samples (n,).

    innovations: (k,) mean of their squares, each in units of its variance: 1 where samples and sigmas fit; of `judged`
    (k,) samples, good ones that came when their pose was known.
    """

    angles: np.ndarray
    variances: np.ndarray
    used: np.ndarray
    gated: np.ndarray
    innovations: np.ndarray
    judged: np.ndarray


def static_attitude(t: np.ndarray, samples: np.ndarray, sigma: np.ndarray, settings: Filter) -> StaticAttitude:
    """The attitude behind one pose's samples (n, k) [rad] at times t (n,) [s]; sigma (k,): a sample's noise [rad]."""
    from filterpy.kalman import ExtendedKalmanFilter  # imports matplotlib: a second

    k = samples.shape[1]
    ekf = ExtendedKalmanFilter(dim_x=k, dim_z=k)
    ekf.x = samples[0].copy()  # a diffuse state: where it stands does not matter, but for the wrap-around
    ekf.P = np.eye(k) * _DIFFUSE**2
    eye, noise, drift = np.eye(k), sigma**2, _drift(settings)
    gates = _gates(k, settings)
    window = _centres(samples[: settings.window], np.array([0]), np.array([min(len(samples), settings.window)]))[0]
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


def static_attitudes(
    t: np.ndarray, samples: np.ndarray, counts: np.ndarray, sigma: np.ndarray, settings: Filter
) -> StaticAttitudes:
    """`static_attitude` of every pose, all at once: the poses' samples (n, k) [rad] and times (n,) [s] end to end.

    counts: (m,) samples of each pose, none of them zero; sigma: (k,) a sample's noise [rad].
    """
    k = samples.shape[1]
    order = np.argsort(-counts, kind="stable")  # longest first: those with a sample left are always the leading ones
    counts = counts[order]
    starts = (np.cumsum(counts[np.argsort(order)]) - counts[np.argsort(order)])[order]
    left = len(counts) - np.searchsorted(counts[::-1], np.arange(counts[0]), side="right")  # poses with a j-th sample
    drifts = _drift(settings) * np.diff(t, prepend=t[:1])
    drifts[starts] = 0.0
    noise, gates = np.maximum(sigma, _FINEST) ** 2, _gates(k, settings)
    window = _centres(samples, starts, np.minimum(counts, settings.window))
    x, variance = samples[starts], np.full((len(counts), k), _DIFFUSE**2)
    used, squares, judged = np.zeros(len(counts), dtype=np.int64), np.zeros(k), np.zeros(k, dtype=np.int64)
    for j, m in enumerate(left):
        row = starts[:m] + j
        sample, v = samples[row], variance[:m] + drifts[row][:, None]
        known = v < noise
        distance = _wrap(sample - np.where(known, x[:m], window[:m])) ** 2 / (noise + np.where(known, v, noise / 4))
        good = np.empty((m, k), dtype=bool)
        for part, gate in gates.items():
            good[:, part] = (distance[:, part].sum(axis=1) <= gate)[:, None]
        squares += np.sum(np.where(good & known, distance, 0.0), axis=0)
        judged += np.sum(good & known, axis=0)
        gain = np.where(good, v * (1 / (v + noise)), 0.0)
        x[:m] += gain * _wrap(sample - x[:m])
        variance[:m] = (1 - gain) * v * (1 - gain) + gain * noise * gain
        used[:m] += good.all(axis=1)
    back = np.argsort(order)
    mean = squares / np.maximum(judged, 1)
    return StaticAttitudes(_wrap(x)[back], variance[back], used[back], (counts - used)[back], mean, judged)


def _wrap(angle: np.ndarray) -> np.ndarray:
    """Angles [rad] of any size -> the same ones in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _wrap(a - b)


def _drift(settings: Filter) -> float:
    """[rad2 / s]"""
    return float(np.deg2rad(settings.drift_deg_per_sqrt_s) ** 2)


def _gates(k: int, settings: Filter) -> dict[tuple[int, ...], float]:
    """The largest squared Mahalanobis distance of a good sample, by the channels of each sensor."""
    return {part: float(chdtri(len(part), settings.gate_probability)) for part in _SENSORS if part[-1] < k}


def _centres(samples: np.ndarray, starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(m, k) the median of each pose's first angles, about the very first: they may lie on both sides of +-180 deg."""
    first = samples[starts]
    column = np.arange(counts.max())
    row = np.minimum(starts[:, None] + column, len(samples) - 1)
    near = np.where((column < counts[:, None])[:, :, None], _wrap(samples[row] - first[:, None]), np.inf)
    near.sort(axis=1)
    pose = np.arange(len(counts))
    return first + (near[pose, (counts - 1) // 2] + near[pose, counts // 2]) / 2
