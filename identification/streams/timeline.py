"""Time as loggers write it -> strictly increasing time.

The stream is cut where time does not run on by one to five sample intervals; each piece is judged by its start:
- it starts later: a gap. But a short piece far ahead, after which time returns, was a wrong stamp: dropped.
- it starts earlier: samples are dropped until time has passed on. But a piece of some length that starts a second or
  more before: the clock was set back, and from there on all times are shifted so that they run on. (Which clock was
  right can't be told; with the shift one offset holds against a command log, which is what poses are found by.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pandas as pd

from kincal.identification.streams.health import Tally

CONFIRMED = 10  # samples in a row that agree with each other: a clock, not a wrong stamp
GAP = 5.0  # sample intervals
STEP = 1.0  # [s] a smaller step back costs its samples alone


@dataclass
class Timeline:
    tally: Tally
    interval: float | None = None  # [s] median of the first samples
    last: float = -np.inf
    shift: float = 0.0
    repeating: bool = False  # a time may come again
    held: list[pd.DataFrame] = field(default_factory=list)  # a short piece at the end: what follows decides

    def feed(self, chunk: pd.DataFrame, final: bool = False, following: float | None = None) -> pd.DataFrame:
        """The samples of a chunk that can stay, with increasing t; `final`: nothing follows, or a time elsewhere."""
        chunk = pd.concat([*self.held, chunk]) if self.held else chunk
        self.held = []
        t = chunk["t"].to_numpy(float)
        if not len(t) or (len(t) < CONFIRMED and not final):
            self.held = [chunk]
            return chunk.iloc[:0]
        steps = np.diff(t)
        if self.interval is None and (steps > 0).any():
            self.interval = float(np.median(steps[steps > 0]))
        cuts = np.flatnonzero(self._back(steps) | (steps > self._limit)) + 1
        bounds = np.concatenate([[0], cuts, [len(t)]]).astype(int)
        if not final and bounds[-1] - bounds[-2] < CONFIRMED:
            self.held = [chunk.iloc[bounds[-2] :]]
            bounds = bounds[:-1]
        times, keep = np.empty(len(t)), np.zeros(len(t), dtype=bool)
        for begin, end in pairwise(bounds):
            after = float(t[end]) if end < len(t) else following
            times[begin:end], keep[begin:end] = self._piece(t[begin:end], after)
        return chunk.iloc[keep].assign(t=times[keep])

    def _back(self, steps: np.ndarray) -> np.ndarray:
        return steps < 0 if self.repeating else steps <= 0

    @property
    def _limit(self) -> float:
        return np.inf if self.interval is None else GAP * self.interval

    def _piece(self, t: np.ndarray, following: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Times and which to keep of samples that run on from each other; following: the time after them."""
        times, tally, ahead = t + self.shift, self.tally, t[0] + self.shift - self.last
        if ahead > self._limit:
            if len(t) < CONFIRMED and following is not None and self.last < following + self.shift < times[0]:
                tally.jumped += len(t)
                return times, np.zeros(len(t), dtype=bool)
            if np.isfinite(ahead):
                tally.gaps += 1
                tally.longest_gap = max(tally.longest_gap, float(ahead))
        elif len(t) >= CONFIRMED and -ahead >= max(STEP, self._limit):
            step = (self.interval or 0.0) - ahead
            self.shift, tally.shift, tally.clock_steps = self.shift + step, tally.shift + step, tally.clock_steps + 1
            times = times + step
        keep = ~self._back(times - self.last)
        tally.repeated += int((times[~keep] == self.last).sum())
        tally.backwards += int((times < self.last).sum())
        if keep.any():
            self.last = float(times[-1])
        return times, keep
