"""The hidden layers of a network pre-trained on virtual siblings, to all joints: what residuals of such a robot look
like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from kincal.learning.network import Network, split
from kincal.learning.units.group import Evidence, Group
from kincal.learning.units.shared import tanh

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True)
class Inherited(Group):
    """y (n, r) = network(x), and how large each of them is on each joint."""

    name: ClassVar[str] = "inherited"
    network: Network
    spread: np.ndarray  # (r, k) one sigma of the coefficients among siblings

    @classmethod
    def of(cls, evidence: Evidence) -> Inherited | None:
        return evidence.inherited if isinstance(evidence.inherited, cls) else None

    def joints(self, n_joints: int) -> np.ndarray:
        return np.repeat(np.arange(n_joints), len(self.spread))

    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        y = self.network(x)
        return np.concatenate([y * self.spread[:, j] for j in range(u.shape[1])], axis=1)

    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        """With the readout multiplied into the last layer."""
        network, readout = self.network, weights.reshape(-1, len(self.spread)) * self.spread.T
        w1, b1, w2, b2, w3, b3 = split(network.weights, network.sizes)
        last = readout * network.output_scale
        first = tanh((w1 / network.input_scale) @ x + (b1 - (w1 / network.input_scale) @ network.input_centre))
        return (last @ w3) @ tanh(w2 @ first + b2) + last @ b3
