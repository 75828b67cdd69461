"""Radial units, each of one joint and moving it alone: smooth errors of an actuator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from kincal.learning.units.group import Evidence, Group

if TYPE_CHECKING:
    import casadi as ca

_REACH = 1.2  # of the centres: a little beyond the range
_WIDTH = 1.5  # of a unit, in distances between centres
_FAR = 3.0  # in ranges: beyond, nothing is believed, and exponentials would overflow


@dataclass(frozen=True)
class Own(Group):
    """The same number for each joint, at evenly spaced centres."""

    name: ClassVar[str] = "own"
    count: int  # a joint

    @classmethod
    def of(cls, evidence: Evidence) -> Self | None:
        return cls(evidence.own) if evidence.own else None

    def joints(self, n_joints: int) -> np.ndarray:
        return np.repeat(np.arange(n_joints), self.count)

    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        centres, width = self._centres()
        return np.exp(-0.5 * ((u[:, :, None] - centres) / width) ** 2).reshape(len(u), -1)

    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        import casadi as ca  # by those who generate code alone

        rows = weights.reshape(-1, self.count)
        return ca.vertcat(*(self._radial(row, u[j]) for j, row in enumerate(rows)))

    def _radial(self, weights: np.ndarray, u: ca.SX) -> ca.SX:
        """The sum of one joint's units. Their centres are evenly spaced: each is a power of one exponential.

        exp(-(u - c_i)^2 / 2 w^2) = exp(-(u^2 - c_0^2) / 2 w^2 + ..) g^i with g = exp(u h / w^2), c_i = c_0 + i h.
        """
        import casadi as ca

        centres, width = self._centres()
        u = ca.fmin(ca.fmax(u, -_FAR), _FAR) / width
        first, space = centres[0] / width, (centres[-1] - centres[0]) / max(len(centres) - 1, 1) / width
        powers, total = ca.exp(u * space), ca.SX(0)
        for i, weight in reversed(list(enumerate(weights))):
            total = total * powers + weight * np.exp(-0.5 * (i * space) ** 2 - i * first * space)
        return total * ca.exp(-0.5 * (u - first) ** 2)

    def _centres(self) -> tuple[np.ndarray, float]:
        """(count,) of one joint's units, and their width, in scaled readings."""
        centres = np.linspace(-_REACH, _REACH, self.count)
        return centres, _WIDTH * (centres[1] - centres[0]) if self.count > 1 else _REACH
