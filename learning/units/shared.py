"""Tanh units from all joints to all: smooth errors that depend on the whole configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from kincal.learning.units.group import Evidence, Group

if TYPE_CHECKING:
    import casadi as ca

_STEEPNESS = 0.7  # over the range: smooth functions


@dataclass(frozen=True)
class Shared(Group):
    """Of random directions, which stay as they are."""

    name: ClassVar[str] = "shared"
    hidden: np.ndarray  # (h, k + 1) weights and biases

    @classmethod
    def of(cls, evidence: Evidence) -> Self | None:
        return cls.random(evidence.u.shape[1], evidence.shared, evidence.seed) if evidence.shared else None

    @classmethod
    def random(cls, n_joints: int, count: int, seed: int) -> Self:
        """`count` units whose steepness and bias are such that they bend within the range."""
        random = np.random.default_rng([seed, 8])
        directions = random.normal(size=(count, n_joints))
        weights = _STEEPNESS * directions
        return cls(np.column_stack([weights, random.uniform(-1, 1, count) * np.linalg.norm(weights, axis=1)]))

    def joints(self, n_joints: int) -> np.ndarray:
        return np.repeat(np.arange(n_joints), len(self.hidden))

    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        hidden = np.tanh(u @ self.hidden[:, :-1].T + self.hidden[:, -1])
        return np.tile(hidden, (1, u.shape[1]))

    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        return weights.reshape(-1, len(self.hidden)) @ tanh(self.hidden[:, :-1] @ u + self.hidden[:, -1])


def tanh(x: Any) -> Any:
    """By exp, which takes half as long as tanh; to an absolute 1e-16."""
    import casadi as ca  # by those who generate code alone

    return 1 - 2 / (1 + ca.exp(2 * x))
