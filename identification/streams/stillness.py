"""When a sensor was still: medians over short bins of time, and how far they move from one to the next.

The noise of a sample is taken from second differences, which a steady motion leaves out; a median of n samples scatters
by 1.2533 sigma / sqrt(n). What moves further than six of these is motion. A gyro, where there is one, sees motion that
tilt does not (about gravity).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.urdf.errors import InputError
from kincal.urdf.input_files import check_records
from kincal.urdf.rigid_motion import wrap

CHANNELS = ("roll", "pitch", "gyro_x", "gyro_y", "gyro_z")
_SAMPLES, _SECONDS = 5, 0.2  # a bin holds at least so many, and lasts at least so long
_MOST_SAMPLES = 1_000_000  # that a bin may hold
_SIGMAS = 6.0
_MEDIAN = 1.2533  # sigma of a median of n samples, times sqrt(n) (normal)
_NORMAL, _QUARTER = 0.67449, 0.31864  # median and first quartile of a standard normal variable's absolute value
_COLOURED = 5.0  # times white noise: what else is no motion
_SLOW = 1.0  # [s] slower motion shows over a longer time


@dataclass(frozen=True)
class Bins:
    """m stretches of equal length that have samples, in order of time.

    start: (m,) [s]; medians: (m, k) of the channels, roll and pitch [rad] first, then gyro [rad/s] where there is one;
    noise: (k,) one sigma of a sample; samples: how many a usual bin has.
    """

    width: float  # [s]
    start: np.ndarray
    medians: np.ndarray
    noise: np.ndarray
    samples: float

    def moving(self) -> np.ndarray:
        """(m,) whether a bin is not where the one before was, or the one a second before; or whether it turns."""
        return self._moved(1) | self._moved(max(1, round(_SLOW / self.width))) | self._turning()

    @property
    def beyond(self) -> bool:
        """Whether roll or pitch spans more than half a turn: then it crosses +-180 degrees, or is not in radians."""
        return bool(len(self.medians) and np.max(np.ptp(self.medians[:, :2], axis=0)) > np.pi)

    def from_degrees(self) -> Bins:
        """The same where roll and pitch are in degrees."""
        scale = np.where(np.arange(len(self.noise)) < 2, np.pi / 180, 1.0)
        return replace(self, medians=self.medians * scale, noise=self.noise * scale)

    def _moved(self, lag: int) -> np.ndarray:
        apart = np.abs(wrap(self.medians[lag:, :2] - self.medians[:-lag, :2]))
        near = self.start[lag:] - self.start[:-lag] < 2 * lag * self.width  # across a gap anything may have happened
        white = np.sqrt(2) * self._sigma[:2]
        if near.any():  # noise that is not white moves the medians more, but not any motion is noise
            usual = np.quantile(apart[near], 0.25, axis=0) / _QUARTER
            white = np.clip(usual, white, _COLOURED * white)
        away = (apart > _SIGMAS * white).any(axis=1) | ~near
        return np.concatenate([np.zeros(len(self.start) - len(away), dtype=bool), away])

    def _turning(self) -> np.ndarray:
        rates = self.medians[:, 2:]
        if not rates.size:
            return np.zeros(len(self.start), dtype=bool)
        return np.any(np.abs(rates - np.nanmedian(rates, axis=0)) > _SIGMAS * self._sigma[2:], axis=1)

    @property
    def _sigma(self) -> np.ndarray:
        return _MEDIAN * self.noise / np.sqrt(self.samples)


def binned(chunks: Iterable[pd.DataFrame], file: Path) -> Bins:
    """Medians of a whole stream; the chunks themselves are not kept. Raises InputError where too much would be."""
    width, origin, channels = 0.0, 0.0, list(CHANNELS)
    held: pd.DataFrame | None = None
    starts, medians, counts, noises = [], [], [], []
    n_samples = n_kept = 0
    for chunk in chunks:
        n_samples += len(chunk)
        if not len(chunk):
            continue
        held = chunk if held is None else pd.concat([held, chunk])
        t = held["t"].to_numpy(float)
        if not width:
            if len(t) < 2:
                continue
            width, origin = max(_SAMPLES * float(np.median(np.diff(t))), _SECONDS), t[0]
        index = np.floor((t - origin) / width)
        whole = index < index[-1]  # the last bin may go on in the next chunk
        if not whole.any():
            if len(held) > _MOST_SAMPLES:  # they are kept until the next bin begins
                many = f"{len(held)} samples within {width:.3g} s; allowed are {_MOST_SAMPLES}"
                raise InputError(f"{file}: {many}. Check the unit of t")
            continue
        channels = [c for c in channels if c in held]
        _add(held.iloc[whole], index[whole], channels, origin, width, (starts, medians, counts, noises))
        held = held.iloc[~whole]
        n_kept += medians[-1].size
        check_records(file, n_samples, n_kept)
    if held is not None and width:
        index = np.floor((held["t"].to_numpy(float) - origin) / width)
        _add(held, index, [c for c in channels if c in held], origin, width, (starts, medians, counts, noises))
    if not starts:
        return Bins(1.0, np.zeros(0), np.zeros((0, 2)), np.zeros(2), 1.0)
    middle, noise = np.vstack(medians), pd.DataFrame(np.vstack(noises)).median().to_numpy(float)
    known = np.isfinite(middle).mean(axis=0) > 0.9  # a gyro that is mostly not there is none
    return Bins(width, np.concatenate(starts), middle[:, known], noise[known], float(np.median(np.concatenate(counts))))


def _add(samples: pd.DataFrame, index: np.ndarray, channels: list[str], origin: float, width: float, into) -> None:
    starts, medians, counts, noises = into
    grouped = samples[channels].groupby(index)
    middle = grouped.median()
    starts.append(origin + middle.index.to_numpy(float) * width)
    medians.append(middle.to_numpy(np.float32))
    counts.append(grouped.size().to_numpy(np.int32))
    noises.append(_noise(samples.loc[:, channels]))


def _noise(samples: pd.DataFrame) -> np.ndarray:
    """(k,) one sigma of samples (n, k), whose resolution sets a floor; NaN where there are too few."""
    steps = samples.diff().abs()
    sigma = samples.diff().diff().abs().median() / (np.sqrt(6) * _NORMAL)
    return np.maximum(sigma, steps.where(steps > 0).min().fillna(0.0) / np.sqrt(12)).to_numpy(float)
