"""A network for what a model leaves, trained through the model: errors e = r + J delta(x), delta zero at the start.

Evidence gates it: cross-validation chooses the weights' decay and a shrinkage factor, down to nothing where the
correction does not pay; outside the hull of the training inputs it fades.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from learning.network import Layout, Network, initial_weights

_DECAYS = (0.01, 0.1, 1.0, 10.0, 100.0)
_SURE = 2.0  # standard errors by which the correction must pay in cross-validation
_MARGIN = 0.1  # of the training range: how far outside the hull the correction has faded to nothing


@dataclass(frozen=True)
class Hull:
    """An outer polytope of points x (n, k): directions . x <= reach, over axes and their pairwise diagonals."""

    directions: np.ndarray  # (n_directions, k), in scaled inputs
    reach: np.ndarray  # (n_directions,)

    @staticmethod
    def of(x: np.ndarray) -> Hull:
        k = x.shape[1]
        eye = np.eye(k)
        diagonals = [(eye[i] + s * eye[j]) / np.sqrt(2) for i, j in combinations(range(k), 2) for s in (1, -1)]
        half = np.array([*eye, *diagonals])
        directions = np.concatenate([half, -half])
        return Hull(directions, (x @ directions.T).max(axis=0))

    def outside(self, x: np.ndarray) -> np.ndarray:
        """(n,) how far x: (n, k) lies outside; 0 inside."""
        return np.maximum((x @ self.directions.T - self.reach).max(axis=1), 0.0)


@dataclass(frozen=True)
class Correction:
    """delta(x) = shrinkage * fade(x) * network(x), in the network's output units."""

    network: Network
    hull: Hull
    shrinkage: float  # 0 .. 1
    decay: float
    gain_of_evidence: float  # mean fall of the weighted square error in cross-validation, in its standard errors

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(n, n_out) at x: (n, n_in)."""
        if self.shrinkage == 0.0:
            return np.zeros((len(x), self.network.sizes[-1]))
        return self.shrinkage * self.fade(x)[:, None] * self.network(x)

    def fade(self, x: np.ndarray) -> np.ndarray:
        """(n,) 1 inside the hull of the training inputs, falling smoothly to 0 outside."""
        distance = np.minimum(self.hull.outside(self.network.scaled(x)) / (2 * _MARGIN), 1.0)  # a range is 2 wide
        return (1 - distance**2) ** 2


def fit_correction(
    x: np.ndarray,
    error: np.ndarray,
    gain: np.ndarray,
    folds: list[np.ndarray],
    fold_errors: np.ndarray,
    *,
    own: int,
    shared: int,
    iterations: int,
    seed: int,
) -> Correction:
    """Fit delta to weighted errors (n, m) of a model at inputs x (n, k), with gain (n, m, k) = d error / d delta.

    folds: rows held out in turn; fold_errors: (n_folds, n, m), the model's errors where it has not seen that fold.
    """
    from learning.training import Problem, levenberg_marquardt  # imports torch: two seconds, for those who train

    layout = Layout.joint_wise(x.shape[1], own, shared)
    low, high = x.min(axis=0), x.max(axis=0)
    span = np.maximum((high - low) / 2, 1e-12)
    # the least change of the inputs that explains each error sets the output's scale
    needed = -(np.linalg.pinv(gain) @ error[..., None])[..., 0]
    scale = np.maximum(np.sqrt(np.mean(needed**2, axis=0)), 1e-12)
    start = initial_weights(layout, np.random.default_rng([seed, 8]), zero_output=True)
    network = Network(layout.sizes, start, (low + high) / 2, span, scale)
    scaled, gain = network.scaled(x), gain * scale
    # weighted so that the decay means the same whatever the errors' size
    weight = 1.0 / max(float(np.mean(error**2)), 1e-300)
    cases = [(decay, k) for decay in _DECAYS for k in range(len(folds))]
    train = np.full((len(cases), len(x)), weight)
    for case, (_, k) in enumerate(cases):
        train[case, folds[k]] = 0.0

    def fit(offsets: np.ndarray, rows: np.ndarray, decays: np.ndarray) -> np.ndarray:
        n = len(offsets)
        problem = Problem(
            np.repeat(scaled[None], n, 0), offsets, np.repeat(gain[None], n, 0), rows, np.zeros_like(rows)
        )
        begins = np.repeat(start[None], n, 0)
        return levenberg_marquardt(
            problem, layout, begins, iterations=iterations, patience=iterations, decay=decays
        ).weights

    offsets = np.stack([fold_errors[k] for _, k in cases])
    weights = fit(offsets, train, np.array([decay for decay, _ in cases]))
    best = (np.inf, _DECAYS[-1], 0.0, 0.0)
    for decay in _DECAYS:
        before, change = np.zeros_like(error), np.zeros_like(error)
        for case, (used, k) in enumerate(cases):
            if used == decay:
                rows = folds[k]
                y = network.with_weights(weights[case])(x[rows]) / scale
                before[rows], change[rows] = fold_errors[k][rows], (gain[rows] @ y[..., None])[..., 0]
        shrinkage = float(np.clip(-np.sum(before * change) / max(np.sum(change**2), 1e-300), 0.0, 1.0))
        after = np.sum((before + shrinkage * change) ** 2, axis=1)
        fall = np.sum(before**2, axis=1) - after
        sure = float(np.mean(fall) / max(np.std(fall, ddof=1) / np.sqrt(len(fall)), 1e-300)) if len(fall) > 1 else 0.0
        best = min(best, (float(np.sum(after)), decay, shrinkage, sure))
    _, decay, shrinkage, sure = best
    if sure < _SURE:
        return Correction(network, Hull.of(scaled), 0.0, decay, sure)
    final = fit(error[None], np.full((1, len(x)), weight), np.array([decay]))[0]
    return Correction(network.with_weights(final), Hull.of(scaled), shrinkage, decay, sure)
