"""What a robot's residual network inherits: the shape of residuals, learned from virtual siblings.

The siblings' residuals are functions of the readings; their principal components are learned by one network, whose
outputs are then hidden units of the real robot's network, with the siblings' spread for a prior.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kincal.learning.network import Network, initial_weights
from kincal.learning.units import Inherited, range_of

_LEAST = 0.02  # of the first component's size: smaller ones are left out
_MOST = 16  # components
_STILL = 1e-10  # of the joint that gives most: one that gives less does not, but for rounding


def inherit(
    x: np.ndarray,
    residuals: np.ndarray,
    *,
    hidden: int,
    iterations: int,
    seed: int,
    progress: Callable[[int, float], None] = lambda done, loss: None,
) -> tuple[Inherited, np.ndarray]:
    """Learn residuals (s, n, k) of s siblings at readings x (n, k); also the training curve (iterations, 2)."""
    from kincal.learning.first_order import adam  # imports torch: two seconds, for those who train
    from kincal.learning.members import Problem

    s, n, k = residuals.shape
    size = np.sqrt(np.mean(residuals**2, axis=(0, 1)))  # of each joint
    size = np.maximum(size, max(_STILL * float(size.max()), 1e-300))
    tall = (residuals / size).transpose(1, 0, 2).reshape(n, s * k)
    left, sizes, right = np.linalg.svd(tall, full_matrices=False)
    kept = max(min(int(np.sum(sizes > _LEAST * sizes[0])), _MOST), 1)
    components = np.sqrt(n) * left[:, :kept]  # of unit size
    shares = sizes[:kept] / max(float(np.linalg.norm(sizes[:kept])), 1e-300)
    coefficients = (sizes[:kept, None] * right[:kept]).reshape(kept, s, k) / np.sqrt(n)
    sizes = (k, hidden, hidden, kept)
    start = initial_weights(sizes, np.random.default_rng([seed, 11]))
    centre, span = range_of(x)
    network = Network(sizes, start, centre, span, np.ones(kept))
    # an error counts by the share of all residuals that it is an error of
    gain = np.broadcast_to(np.diag(shares), (1, n, kept, kept))
    ones = np.ones((1, n))
    problem = Problem(network.scaled(x)[None], -(components * shares)[None], gain, ones, 0 * ones)
    trained = adam(problem, sizes, start[None], iterations=iterations, progress=progress)
    return Inherited(network.with_weights(trained.weights[0]), np.sqrt(np.mean(coefficients**2, axis=1))), trained.curve
