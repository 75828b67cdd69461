"""Sine and cosine of one joint, moving it alone: periodic errors of screws, gears and encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from kincal.learning.units.group import Evidence, Group
from kincal.learning.waves import find_waves

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True)
class Waves(Group):
    """Those that the poses show."""

    name: ClassVar[str] = "waves"
    periodic: np.ndarray  # (w, 2) joint and cycles over the range

    @classmethod
    def of(cls, evidence: Evidence) -> Self | None:
        periodic = find_waves(evidence.u, evidence.error, evidence.explained, evidence.by_output)
        return cls(periodic) if len(periodic) else None

    def joints(self, n_joints: int) -> np.ndarray:
        return np.repeat(self.periodic[:, 0].astype(int), 2)

    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        phase = np.pi * self.periodic[:, 1] * (u[:, self.periodic[:, 0].astype(int)] + 1)
        return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(u), -1)

    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        import casadi as ca  # by those who generate code alone

        total = ca.SX.zeros(u.shape[0])
        for (j, cycles), (sine, cosine) in zip(self.periodic, weights.reshape(-1, 2), strict=True):
            phase = np.pi * cycles * (u[int(j)] + 1)
            total[int(j)] += sine * ca.sin(phase) + cosine * ca.cos(phase)
        return total
