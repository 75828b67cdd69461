"""The residual network's hidden units, in four groups; what it puts out is linear in them.

own: radial units, each of one joint and moving it alone. waves: sine and cosine of one joint, moving it alone. shared:
tanh units from all joints to all. inherited: the hidden layers of a network pre-trained on virtual siblings, to all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.learning.network import Network

OWN, WAVES, SHARED, INHERITED = "own", "waves", "shared", "inherited"
_REACH = 1.2  # of the radial units' centres: a little beyond the range
_WIDTH = 1.5  # of a radial unit, in distances between centres
_STEEPNESS = 0.7  # of the shared units over the range: smooth functions


@dataclass(frozen=True)
class Inherited:
    """What residuals of such a robot look like: y (n, r) = network(x), and how large each is on each joint."""

    network: Network
    spread: np.ndarray  # (r, k) one sigma of the coefficients among siblings


@dataclass(frozen=True)
class Units:
    """Inputs x (n, k) are scaled to -1 .. 1 by centre and span."""

    centre: np.ndarray  # (k,)
    span: np.ndarray  # (k,)
    own: int  # radial units a joint
    waves: np.ndarray  # (w, 2) joint and cycles over the range
    shared: np.ndarray  # (h, k + 1) weights and biases
    inherited: Inherited | None

    @property
    def n_joints(self) -> int:
        return len(self.centre)

    def scaled(self, x: np.ndarray) -> np.ndarray:
        return (x - self.centre) / self.span

    @property
    def layout(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """The joint that each weight moves, (n_weights,), and its group's name."""
        k, joints, names = self.n_joints, [], []
        for j in range(k):
            joints += [j] * self.own
            names += [OWN] * self.own
        for j, _ in self.waves:
            joints += [int(j)] * 2
            names += [WAVES] * 2
        for name, count in ((SHARED, len(self.shared)), (INHERITED, self._n_inherited)):
            for j in range(k):
                joints += [j] * count
                names += [name] * count
        return np.array(joints, dtype=int), tuple(names)

    def values(self, x: np.ndarray) -> np.ndarray:
        """(n, n_weights): every weight's unit at x: (n, k)."""
        u = self.scaled(x)
        parts = []
        if self.own:
            centres, width = own_centres(self.own)
            parts += [np.exp(-0.5 * ((u[:, [j]] - centres) / width) ** 2) for j in range(self.n_joints)]
        for j, cycles in self.waves:
            phase = np.pi * cycles * (u[:, int(j)] + 1)
            parts.append(np.stack([np.sin(phase), np.cos(phase)], axis=1))
        if len(self.shared):
            hidden = np.tanh(u @ self.shared[:, :-1].T + self.shared[:, -1])
            parts.append(np.tile(hidden, (1, self.n_joints)))
        if self.inherited is not None:
            y = self.inherited.network(x)
            parts += [y * self.inherited.spread[:, j] for j in range(self.n_joints)]
        return np.concatenate(parts, axis=1) if parts else np.zeros((len(x), 0))

    @property
    def _n_inherited(self) -> int:
        return 0 if self.inherited is None else len(self.inherited.spread)


def own_centres(count: int) -> tuple[np.ndarray, float]:
    """Centres (count,) of one joint's radial units, and their width, in scaled inputs."""
    centres = np.linspace(-_REACH, _REACH, count)
    return centres, _WIDTH * (centres[1] - centres[0]) if count > 1 else _REACH


def range_of(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half the range of inputs (n, k); an input that never moves has a range of one."""
    low, high = x.min(axis=0), x.max(axis=0)
    half = (high - low) / 2
    return (low + high) / 2, np.where(half > 1e-12, half, 1.0)


def shared_units(n_joints: int, count: int, seed: int) -> np.ndarray:
    """(count, n_joints + 1): random directions, steepness and bias such that units bend within the range."""
    random = np.random.default_rng([seed, 8])
    directions = random.normal(size=(count, n_joints))
    weights = _STEEPNESS * directions
    return np.column_stack([weights, random.uniform(-1, 1, count) * np.linalg.norm(weights, axis=1)])
