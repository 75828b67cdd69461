"""Raw inclinometer streams -> one attitude a static pose, by the filter of static poses over each stretch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from kincal.identification.innovations import StaticInnovations
from kincal.identification.measurement_table import UNITS
from kincal.identification.static_poses import static_attitudes
from kincal.identification.streams.campaign import DroppedPose
from kincal.identification.streams.repeats import STUCK
from kincal.urdf.description import Filter, Sensor
from kincal.urdf.errors import InputError, quoted

CHANNELS = ("roll", "pitch", "yaw")
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


@dataclass(frozen=True)
class FilteredPoses:
    """rows: one a pose: pose, roll, pitch, tilt_std [rad] (and yaw, yaw_std), used and gated samples."""

    rows: pd.DataFrame
    dropped: tuple[DroppedPose, ...]  # that the stream can't tell
    innovations: tuple[StaticInnovations, ...] = ()
    yaw_stuck: int | None = None  # poses; more than half of all: nothing is behind that channel, it was left out


def filter_stream(
    stream: pd.DataFrame, poses: np.ndarray, sensor: Sensor, settings: Filter, source: str
) -> FilteredPoses:
    """The attitudes of `poses` (n,), in their order; those that can't be used are dropped, with the reason.

    `source` names the stream in messages. Raises InputError where half or more of the poses would be dropped.
    """
    channels = [c for c in CHANNELS if c in stream]
    whole = _Stretches.of(stream, channels)
    seen = np.isin(poses, whole.pose)
    asked = whole[np.searchsorted(whole.pose, poses[seen])]
    yaw_stuck = int(_stuck(asked)[:, 2:].sum())
    if 2 * yaw_stuck > len(asked.pose):
        without = filter_stream(stream.drop(columns="yaw"), poses, sensor, settings, source)
        return replace(without, yaw_stuck=yaw_stuck)
    dropped = dict.fromkeys(poses[~seen].tolist(), f"it has no sample; allowed is at least {settings.min_samples}")
    dropped |= _unusable(asked, channels, settings)
    _require(dropped, poses, source)
    usable = asked[np.flatnonzero(~np.isin(asked.pose, list(dropped)))]
    noisy = whole[np.flatnonzero(~np.isin(whole.pose, list(dropped)))]
    sigma = np.array([_sample_sigma(sensor, channel, noisy, k) for k, channel in enumerate(channels)])
    attitudes = static_attitudes(usable.t, usable.samples, usable.counts, sigma, settings)
    good = attitudes.used >= np.maximum(settings.min_samples, attitudes.gated)
    for k in np.flatnonzero(~good):
        dropped[usable.pose[k]] = (
            f"{attitudes.gated[k]} of {usable.counts[k]} samples are outliers; "
            f"allowed are fewer than half, and at least {settings.min_samples} good samples"
        )
    _require(dropped, poses, source)
    angles, variances, pose = attitudes.angles[good], attitudes.variances[good], usable.pose[good].astype(np.int64)
    tilt_std = np.sqrt(variances[:, :2].mean(axis=1))
    rows = {"pose": pose, "roll": angles[:, 0], "pitch": angles[:, 1], "tilt_std": tilt_std}
    if "yaw" in channels:
        rows |= {"yaw": angles[:, 2], "yaw_std": np.sqrt(variances[:, 2])}
    rows |= {"used": attitudes.used[good], "gated": attitudes.gated[good]}
    innovations = zip(channels, attitudes.innovations.tolist(), attitudes.judged.tolist(), strict=True)
    told = tuple(StaticInnovations(*each) for each in innovations if each[2])
    return FilteredPoses(pd.DataFrame(rows), _in_order(dropped, poses), told)


def _unusable(stretches: _Stretches, channels: list[str], settings: Filter) -> dict[int, str]:
    """Poses with too few samples or a stuck channel, and why."""
    samples, counts = stretches.samples, stretches.counts
    few = np.flatnonzero(counts < settings.min_samples)
    reasons = {
        stretches.pose[k]: f"it has {counts[k]} samples; allowed is at least {settings.min_samples}" for k in few
    }
    for k, channel in np.argwhere(_stuck(stretches)):
        value = samples[stretches.starts[k], channel] / UNITS["deg"]
        reason = f"channel {quoted(channels[channel])} is stuck at {value:.6g} degrees for all {counts[k]} samples"
        reasons.setdefault(stretches.pose[k], reason)
    return reasons


def _in_order(dropped: Mapping[int, str], poses: np.ndarray) -> tuple[DroppedPose, ...]:
    return tuple(DroppedPose(p, dropped[p]) for p in poses.tolist() if p in dropped)


def _require(dropped: Mapping[int, str], poses: np.ndarray, source: str) -> None:
    """Refuse a stream that tells less than half of the poses."""
    if dropped and 2 * len(dropped) >= len(poses):
        first = _in_order(dropped, poses)[0]
        raise InputError(
            f"{source}: {len(dropped)} of {len(poses)} poses can't be used; allowed are fewer than half; "
            f"the first is pose {first.pose}: {first.reason}"
        )


def _sample_sigma(sensor: Sensor, channel: str, stretches: _Stretches, k: int) -> float:
    """One sigma of a sample [rad]: as given, else from the median difference within poses, which outliers spare."""
    kind = "yaw" if channel == "yaw" else "tilt"
    if sensor.given(kind):
        return sensor.sigma(kind)
    differences = np.delete(np.abs(np.diff(stretches.samples[:, k])), stretches.starts[1:] - 1)
    differences = differences[np.isfinite(differences)]
    estimate = float(np.median(differences)) / (np.sqrt(2) * _MEDIAN) if len(differences) else 0.0
    return estimate or sensor.sigma(kind)


def _stuck(stretches: _Stretches) -> np.ndarray:
    """(m, k) whether a channel has one value for all of a pose's samples."""
    samples, starts = stretches.samples, stretches.starts
    if not len(starts):
        return np.zeros((0, samples.shape[1]), dtype=bool)
    same = np.maximum.reduceat(samples, starts) == np.minimum.reduceat(samples, starts)
    return same & (stretches.counts >= STUCK)[:, None]
