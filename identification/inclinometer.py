"""Raw inclinometer streams -> one attitude a static pose, by the filter of static poses over each stretch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from identification.measurements import UNITS, load, numbers
from identification.static_poses import static_attitudes
from urdf.description import Column, Filter, Measure, Sensor
from urdf.errors import InputError

CHANNELS = ("roll", "pitch", "yaw")
_STUCK = 10  # samples: fewer may well be alike
_MEDIAN = 0.67449  # of the absolute value of a standard normal variable


@dataclass(frozen=True)
class _Stretches:
    """A stream's samples with each pose's end to end, in their order of time."""

    t: np.ndarray  # (n,) [s]
    samples: np.ndarray  # (n, k) [rad]
    pose: np.ndarray  # (m,) the poses' numbers, ascending
    starts: np.ndarray  # (m,) where each begins
    counts: np.ndarray  # (m,)

    @staticmethod
    def of(stream: pd.DataFrame, channels: list[str]) -> _Stretches:
        t, samples = stream["t"].to_numpy(float), stream[channels].to_numpy(float)
        order = np.argsort(stream["pose"].to_numpy(), kind="stable")
        pose, counts = np.unique(stream["pose"].to_numpy(), return_counts=True)
        return _Stretches(t[order], samples[order], pose, np.cumsum(counts) - counts, counts)

    def __getitem__(self, which: np.ndarray) -> _Stretches:
        """Those of some poses, by their places (m,), in that order."""
        counts = self.counts[which]
        starts = np.cumsum(counts) - counts
        row = np.repeat(self.starts[which] - starts, counts) + np.arange(counts.sum())
        return _Stretches(self.t[row], self.samples[row], self.pose[which], starts, counts)


def read_stream(file: Path, measure: Measure) -> pd.DataFrame:
    """A stream file as t [s], pose, roll, pitch [rad] and, where it has one, yaw. Raises InputError as `read_table`."""
    raw = load(file, measure)
    columns = {}
    for name in ("t", "pose", *CHANNELS):
        column = measure.columns.get(name, Column.model_validate({"from": name}))
        source = column.source if column.source in raw.columns else name
        if source in raw.columns:
            found = column if source == column.source else Column.model_validate({"from": name})
            columns[name] = numbers(raw[source].tolist(), found, file)
        elif name != "yaw":
            found = ", ".join(map(str, raw.columns))
            raise InputError(f"{file}: column {source!r} is missing from the stream; it has {found}")
    stream = pd.DataFrame(columns)
    backwards = np.flatnonzero(np.diff(stream["t"].to_numpy()) < 0)
    if len(backwards):
        row, t = backwards[0] + 1, stream["t"].to_numpy()
        raise InputError(f"{file}: column 't', row {row + 1}: time runs backwards, from {t[row - 1]:g} to {t[row]:g} s")
    return stream


def filter_stream(stream: pd.DataFrame, poses: np.ndarray, sensor: Sensor, settings: Filter, what: str) -> pd.DataFrame:
    """One row a pose of `poses` (n,): roll, pitch, tilt_std [rad] (and yaw, yaw_std), used and gated samples.

    `what` names the stream in messages. Raises InputError for a pose without samples, and for a stuck channel.
    """
    channels = [c for c in CHANNELS if c in stream]
    whole = _Stretches.of(stream, channels)
    sigma = np.array([_sample_sigma(sensor, channel, whole, k) for k, channel in enumerate(channels)])
    missing = poses[~np.isin(poses, whole.pose)]
    if len(missing):
        raise InputError(f"{what}: pose {missing[0]} has no sample; allowed is at least {settings.min_samples}")
    asked = whole[np.searchsorted(whole.pose, poses)]
    _check(asked, channels, settings, what)
    found = static_attitudes(asked.t, asked.samples, asked.counts, sigma, settings)
    doubtful = np.flatnonzero(found.used < np.maximum(settings.min_samples, found.gated))
    if len(doubtful):
        k = doubtful[0]
        raise InputError(
            f"{what}: pose {asked.pose[k]}: {found.gated[k]} of {asked.counts[k]} samples are outliers; "
            f"allowed are fewer than half, and at least {settings.min_samples} good samples"
        )
    angles, variances = found.angles, found.variances
    tilt_std = np.sqrt(variances[:, :2].mean(axis=1))
    rows = {"pose": asked.pose.astype(np.int64), "roll": angles[:, 0], "pitch": angles[:, 1], "tilt_std": tilt_std}
    if "yaw" in channels:
        rows |= {"yaw": angles[:, 2], "yaw_std": np.sqrt(variances[:, 2])}
    return pd.DataFrame(rows | {"used": found.used, "gated": found.gated})


def _sample_sigma(sensor: Sensor, channel: str, stretches: _Stretches, k: int) -> float:
    """One sigma of a sample [rad]: as given, else from the median difference within poses, which outliers spare."""
    kind = "yaw" if channel == "yaw" else "tilt"
    if sensor.given(kind):
        return sensor.sigma(kind)
    differences = np.delete(np.abs(np.diff(stretches.samples[:, k])), stretches.starts[1:] - 1)
    differences = differences[np.isfinite(differences)]
    estimate = float(np.median(differences)) / (np.sqrt(2) * _MEDIAN) if len(differences) else 0.0
    return estimate or sensor.sigma(kind)


def _check(stretches: _Stretches, channels: list[str], settings: Filter, what: str) -> None:
    few = np.flatnonzero(stretches.counts < settings.min_samples)
    if len(few):
        pose, count = stretches.pose[few[0]], stretches.counts[few[0]]
        raise InputError(f"{what}: pose {pose} has {count} samples; allowed is at least {settings.min_samples}")
    samples, starts = stretches.samples, stretches.starts
    same = np.maximum.reduceat(samples, starts) == np.minimum.reduceat(samples, starts)
    stuck = np.argwhere(same & (stretches.counts >= _STUCK)[:, None])
    if len(stuck):
        pose, k = stuck[0]
        raise InputError(
            f"{what}: pose {stretches.pose[pose]}: channel {channels[k]!r} is stuck at "
            f"{samples[starts[pose], k] / UNITS['deg']:.6g} degrees for all {stretches.counts[pose]} samples; "
            f"allowed is a sensor that moves with its noise"
        )
