"""Stuck and saturated channels: runs of one value that are longer than the channel's resolution explains.

A channel of coarse resolution, or one that is logged faster than it is sampled, repeats values in health. So the share
p of samples that repeat the one before tells how long a run may be: one of n samples has probability p^n.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_IMPROBABLE = math.log(1e-9)
STUCK, _SATURATED = 10, 5  # samples: fewer are never taken for it
_NEVER = 50  # samples of one value in all: worth saying


@dataclass
class Repeats:
    """One channel's runs so far."""

    samples: int = 0
    runs: int = 0
    value: float = math.nan
    length: int = 0
    low: float = math.inf
    high: float = -math.inf

    def mark(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which samples of the next ones (n,) are stuck, and which are saturated."""
        n = len(values)
        if not n:
            return np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
        lengths, value = np.diff(np.append(starts, n)), values[starts]
        carried = self.length if value[0] == self.value else 0
        whole = lengths.copy()
        whole[0] += carried
        self.samples, self.runs = self.samples + n, self.runs + len(starts) - (carried > 0)
        self.value, self.length = float(value[-1]), int(whole[-1])
        finite = values[np.isfinite(values)]
        if len(finite):
            self.low, self.high = min(self.low, float(finite.min())), max(self.high, float(finite.max()))
        extreme = ((value == self.high) | (value == self.low)) & (self.high > self.low)
        allowed = self._longest
        saturated = extreme & (whole >= max(_SATURATED, allowed))
        stuck = ~saturated & (whole >= max(STUCK, allowed))
        return np.repeat(stuck, lengths), np.repeat(saturated, lengths)

    @property
    def constant(self) -> bool:
        return self.runs == 1 and self.samples >= _NEVER

    @property
    def _longest(self) -> float:
        """[samples] a run that chance explains."""
        repeated = 1 - self.runs / self.samples
        return _IMPROBABLE / math.log(repeated) if repeated > 0 else 0.0
