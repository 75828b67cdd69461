"""Whether a filter of static poses was told the truth about its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

_CHANCE, _NEAR = 3.3, 0.1  # standard errors, and what nobody minds


@dataclass(frozen=True)
class StaticInnovations:
    """Of one channel, over all poses: the mean of their squares in units of their variances, of so many samples."""

    channel: str
    mean: float
    samples: int

    @property
    def warning(self) -> str | None:
        """What it means, where it is farther from 1 than chance and a tenth explain."""
        if abs(self.mean - 1) <= _CHANCE * math.sqrt(2 / max(self.samples, 1)) + _NEAR:
            return None
        why = "the target moved, or its sigma is larger" if self.mean > 1 else "its sigma is smaller"
        return (
            f"{self.channel}: innovations have a mean square of {self.mean:.3g}, 1 fits: {why} than the filter was told"
        )
