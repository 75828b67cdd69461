"""The attitude filter: over a whole record, or sample by sample while a target moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kincal.identification.attitude.blocks import Blocks, block_size, size_at, to_blocks
from kincal.identification.attitude.error_state import ErrorStateFilter, Step
from kincal.identification.attitude.estimate import Stretch, bias_free, estimate, roll_pitch_yaw
from kincal.identification.attitude.motion import Nominal, rotation_of
from kincal.identification.attitude.settings import AttitudeEstimate, AttitudeSettings, Samples, check

_CHUNK = 2000  # blocks integrated at once: memory


def filter_attitude(
    t: np.ndarray, samples: Samples, settings: AttitudeSettings, source: str = "samples"
) -> AttitudeEstimate:
    """Attitude at each sample from those before it and its own. t: (n,) [s].

    The first `start_s` seconds share one start, the median of their specific forces. Raises InputError that names
    `source` where the samples can't be filtered.
    """
    check(t, samples, settings, source)
    chunks: list[Blocks] = []
    stretches: list[Stretch] = []
    for blocks, start, step in steps(t, samples, settings):
        if not chunks or blocks is not chunks[-1]:
            chunks.append(blocks)
        stretches.append(stretch(start, step))
    return estimate(len(t), chunks, stretches, learning(len(stretches), settings))


def learning(blocks: int, settings: AttitudeSettings) -> int:
    """Of so many blocks, those in which the filter learns its noise; never more than half."""
    return min(blocks // 2, round(settings.adapt_s / settings.update_s))


def stretch(start: Nominal, step: Step) -> Stretch:
    """What is kept of a step: a long record must not keep all of its matrices."""
    p = step.covariance
    return Stretch(start, step.turn, step.nominal, p[:3, :3].copy(), bias_free(p, step.tilt), step.force, step.heading)


def steps(t: np.ndarray, samples: Samples, settings: AttitudeSettings) -> Iterator[tuple[Blocks, Nominal, Step]]:
    """Block by block: the chunk of blocks it is of, the nominal state at its start, and the filter's step."""
    size = block_size(t, settings)
    chunk, before, ekf = size * _CHUNK, None, None
    for first in range(0, len(t), chunk):
        rows = slice(first, first + chunk)
        blocks = to_blocks(t[rows], taken(samples, rows), size, settings, before)
        before = (float(t[rows][-1]), blocks.rate)
        if ekf is None:
            heard = samples.heading is not None
            ekf = ErrorStateFilter(settings, samples.gyro is not None, heard, blocks.first(settings.start_s))
        for k in range(len(blocks.dt)):
            start = ekf.nominal
            yield blocks, start, ekf.advance(blocks, k)


def taken(samples: Samples, rows: slice) -> Samples:
    """Some rows of all channels."""
    return replace(samples, **{k: v[rows] for k, v in samples.__dict__.items() if v is not None})


class AttitudeFilter:
    """The same filter in real time: one `step` a sample. It has no attitude before the start is over."""

    def __init__(self, settings: AttitudeSettings, rate_hz: float) -> None:
        """rate_hz: of the samples that will come, at which `filter_attitude` would see them."""
        self.settings = settings
        self.size = size_at(rate_hz, settings)
        self.starting = self.size * max(1, -(-round(settings.start_s * rate_hz) // self.size))
        self.ekf: ErrorStateFilter | None = None
        self.before: tuple[float, np.ndarray] | None = None
        self.times: list[float] = []
        self.kept: list[Samples] = []
        self.rotation = np.eye(3)
        self.rate: np.ndarray | None = None
        self.last = 0.0

    def step(self, t: float, sample: Samples) -> np.ndarray | None:
        """Roll, pitch, yaw (3,) [rad] at time t [s] by one sample (arrays without their first axis); None at first.

        Within a block it goes on by the gyro alone; the update comes with the block's last sample. Differs from
        `filter_attitude` only where a spike of the gyro is not yet known for one.
        """
        if self.ekf is not None:
            self._turn(t, sample)
        self.times.append(t)
        self.kept.append(sample)
        if len(self.kept) == (self.size if self.ekf is not None else self.starting):
            self._advance()
        return None if self.ekf is None else roll_pitch_yaw(self.rotation)

    def _turn(self, t: float, sample: Samples) -> None:
        assert self.ekf is not None
        gap = t - self.last
        self.last = t
        if sample.gyro is None or not np.isfinite(sample.gyro).all() or gap > self.settings.largest_gap_s:
            return
        mean = sample.gyro if self.rate is None else (self.rate + sample.gyro) / 2
        self.rotation, self.rate = self.rotation @ rotation_of(gap * (mean - self.ekf.nominal.gyro_bias)), sample.gyro

    def _advance(self) -> None:
        channels = {k: v for k, v in self.kept[0].__dict__.items() if v is not None}
        rows = Samples(**{k: np.array([getattr(s, k) for s in self.kept]) for k in channels})
        t = np.array(self.times)
        blocks = to_blocks(t, rows, self.size, self.settings, self.before)
        if self.ekf is None:
            self.ekf = ErrorStateFilter(
                self.settings, rows.gyro is not None, rows.heading is not None, blocks.first(self.settings.start_s)
            )
        for k in range(len(blocks.dt)):
            self.ekf.advance(blocks, k)
        self.rotation, self.rate, self.last = self.ekf.nominal.rotation, blocks.rate, float(t[-1])
        self.before = (self.last, blocks.rate)
        self.times, self.kept = [], []
