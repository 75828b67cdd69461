"""Samples -> blocks of a fraction of a second: gyros integrated at full rate, specific force averaged along the way.

After Forster et al., On-Manifold Preintegration, IEEE Trans. Robotics 33 (2017) 1-21: within a block the rotation
relative to its start needs no attitude, so all blocks are integrated at once; the gyro's bias comes off afterwards, to
first order in bias times block length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.constants import g
from scipy.spatial.transform import Rotation

from kincal.identification.attitude.settings import AttitudeSettings, Samples

_SPIKE = 8.0  # robust sigmas within a block: a wave does not jump
_MEDIAN = 0.67449  # of the absolute value of a standard normal variable


@dataclass(frozen=True)
class Blocks:
    """b blocks of m samples; a block starts where the one before it ends. What did not come is NaN."""

    dt: np.ndarray  # (b,) [s]
    gap: np.ndarray  # (b,) of it, without known rates [s]
    rotation: np.ndarray  # (b, 3) rotation vector, end relative to start, the gyro's bias in it [rad]
    force: np.ndarray  # (b, 3) mean specific force in the frame of the block's start [m/s2]
    force_variance: np.ndarray  # (b,) white noise of each component [m2/s4]
    heading: np.ndarray  # (b,) at its end [rad]
    partial: np.ndarray  # (b, m, 3) rotation vectors from the block's start to each sample [rad]
    elapsed: np.ndarray  # (b, m) [s]
    rate: np.ndarray  # (3,) the last one, where a next block goes on [rad/s]
    spikes: int  # samples left out

    @property
    def share(self) -> np.ndarray:
        """(b, m) of the block that has passed at each sample."""
        return self.elapsed / np.maximum(self.elapsed[:, -1:], 1e-12)

    def first(self, seconds: float) -> Blocks:
        """Those that begin within so many seconds."""
        k = int(np.sum(np.cumsum(self.dt) - self.dt < seconds))
        rows = {key: value[:k] for key, value in self.__dict__.items() if key not in ("rate", "spikes")}
        return replace(self, **rows)


def block_size(t: np.ndarray, settings: AttitudeSettings) -> int:
    """Samples a block, from the usual interval of samples."""
    step = np.diff(t)
    return size_at(1 / float(np.median(step[step > 0])) if (step > 0).any() else 1.0, settings)


def size_at(rate_hz: float, settings: AttitudeSettings) -> int:
    """Samples a block; a half goes up, whatever rounding made of the rate."""
    return max(1, int(settings.update_s * rate_hz + 0.5 + 1e-6))


def to_blocks(
    t: np.ndarray,
    samples: Samples,
    size: int,
    settings: AttitudeSettings,
    before: tuple[float, np.ndarray] | None = None,
) -> Blocks:
    """Times t (n,) [s] and samples (n) as blocks of `size`, the last one shorter. before: last time and rate."""
    b = -(-len(t) // size)
    missing = b * size - len(t)
    time = np.concatenate([t, np.full(missing, t[-1])])
    dt = np.diff(time, prepend=time[0] if before is None else before[0])
    gap = np.where(dt > settings.largest_gap_s, dt, 0.0)
    sensor, rate_hz = settings.sensor, size / settings.update_s
    partial, rate, gyro_spikes = np.zeros((b, size, 3)), np.zeros(3), 0
    turn = Rotation.identity(b * size)
    if samples.gyro is not None:
        floor = sensor.gyro_noise * np.sqrt(rate_hz)
        gyro, good = _without_spikes(_padded(samples.gyro, missing).reshape(b, size, 3), floor)
        gyro_spikes = int((~good).sum()) - missing
        gyro = gyro.reshape(-1, 3)
        earlier = np.vstack([gyro[:1] if before is None else before[1], gyro[:-1]])
        turn = _chained(np.where(gap > 0, 0.0, dt)[:, None] * (earlier + gyro) / 2, b, size)
        partial, rate = turn.as_rotvec().reshape(b, size, 3), gyro[-1]
    force, noise = _force(samples, settings, rate_hz)
    rotated = turn.apply(_padded(force, missing)).reshape(b, size, 3)
    clean, good = _without_spikes(rotated, noise)
    count = good.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (clean * good[:, :, None]).sum(axis=1) / count[:, None]
        variance = noise**2 / count
    ends = np.minimum(np.arange(1, b + 1) * size, len(t)) - 1
    return Blocks(
        dt=dt.reshape(b, size).sum(axis=1),
        gap=gap.reshape(b, size).sum(axis=1),
        rotation=partial[:, -1],
        force=mean,
        force_variance=variance,
        heading=np.full(b, np.nan) if samples.heading is None else samples.heading[ends],
        partial=partial,
        elapsed=np.cumsum(dt.reshape(b, size), axis=1),
        rate=rate,
        spikes=gyro_spikes + int((~good).sum()) - missing,
    )


def _force(samples: Samples, settings: AttitudeSettings, rate_hz: float) -> tuple[np.ndarray, float]:
    """Specific force (n, 3) [m/s2] and one sigma of a sample: an inclinometer's is the direction, g long."""
    if samples.acceleration is not None:
        return samples.acceleration, settings.sensor.acceleration_noise * np.sqrt(rate_hz)
    assert samples.tilt is not None
    roll, pitch = samples.tilt.T
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    return g * up, g * settings.sensor.tilt_noise


def _padded(values: np.ndarray, missing: int) -> np.ndarray:
    return np.concatenate([values, np.full((missing, *values.shape[1:]), np.nan)])


def _without_spikes(values: np.ndarray, floor: float) -> tuple[np.ndarray, np.ndarray]:
    """(b, m, 3) with spikes and NaN replaced by their block's median (0 where all are NaN), and which were good."""
    finite = np.asarray(np.isfinite(values).all(axis=2))
    some = np.any(finite, axis=1)
    if finite.all():
        centre = np.median(values, axis=1)
        spread = np.median(np.abs(values - centre[:, None]), axis=1)
    else:
        values = np.where(finite[:, :, None], values, np.nan)
        centre, spread = np.zeros((2, len(values), 3))
        centre[some] = np.nanmedian(values[some], axis=1)
        spread[some] = np.nanmedian(np.abs(values[some] - centre[some, None]), axis=1)
    limit = _SPIKE * np.maximum(spread / _MEDIAN, floor)
    good = finite & (np.abs(values - centre[:, None]) <= limit[:, None]).all(axis=2)
    return np.where(good[:, :, None], values, centre[:, None]), good


def _chained(steps: np.ndarray, b: int, size: int) -> Rotation:
    """Rotations (b * size) from each block's start to each of its samples, steps (b * size, 3) [rad] one by one."""
    step = Rotation.from_rotvec(steps).as_quat().reshape(b, size, 4)
    turn = np.empty_like(step)
    turn[:, 0] = step[:, 0]
    for j in range(1, size):
        turn[:, j] = (Rotation.from_quat(turn[:, j - 1]) * Rotation.from_quat(step[:, j])).as_quat()
    return Rotation.from_quat(turn.reshape(-1, 4))
