"""Pre-train on a prior, fine-tune on measured poses (Xu, Tian and Zhang 2024, sections 3.2 and 3.4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from kincal.learning.members import Problem, Trained
from kincal.learning.network import Network, count, initial_weights
from kincal.learning.training import levenberg_marquardt

_LEAST_RANGE = 1e-2  # of an output, of the largest: what a drawing holds still moves as built
_MOST_WEIGHTS_A_VALUE = 100  # the paper itself has 387 weights for 450 values; far beyond, training is no use


def allowed_hidden(n_in: int, n_out: int, n_poses: int) -> int:
    """The most hidden units a layer may have for networks trained on n_poses poses."""
    hidden = 1
    while count((n_in, hidden + 1, hidden + 1, n_out)) <= _MOST_WEIGHTS_A_VALUE * n_poses * n_out:
        hidden += 1
    return hidden


def new_network(joints: np.ndarray, outputs: np.ndarray, hidden: int, seed: int) -> Network:
    """A random network scaled to the source task: joints (n, n_in) and outputs (n, n_out)."""
    low, high, largest = joints.min(axis=0), joints.max(axis=0), np.abs(outputs).max(axis=0)
    sizes = (joints.shape[1], hidden, hidden, outputs.shape[1])
    return Network(
        sizes=sizes,
        weights=initial_weights(sizes, np.random.default_rng([seed, 6])),
        input_centre=(low + high) / 2,
        input_scale=np.where(high > low, (high - low) / 2, 1.0),  # an input that never moves says nothing
        output_scale=np.maximum(largest, max(_LEAST_RANGE * largest.max(), 1e-12)),
    )


def train(
    networks: Sequence[Network],
    joints: np.ndarray,
    outputs: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    *,
    validation: float,
    iterations: int,
    seed: int,
    progress: Callable[[int, float], None] = lambda done, loss: None,
) -> tuple[list[Network], Trained]:
    """Train several networks of one shape at once, each on its own outputs (n, n_out) and rows of joints (n, n_in).

    validation: share of each one's rows that early stopping looks at, drawn with the seed.
    """
    first = networks[0]
    held, used = np.zeros((len(networks), len(joints))), np.zeros((len(networks), len(joints)))
    for k, rows_of_network in enumerate(rows):
        n_held = round(validation * len(rows_of_network)) if len(rows_of_network) > 4 else 0
        order = np.random.default_rng([seed, 7, len(rows_of_network)]).permutation(rows_of_network)
        held[k, order[:n_held]], used[k, order[n_held:]] = 1.0, 1.0
    problem = Problem(
        x=np.stack([network.scaled(joints) for network in networks]),
        offset=-np.stack([y / network.output_scale for network, y in zip(networks, outputs, strict=True)]),
        gain=None,
        train=used,
        validate=held,
    )
    sizes = first.sizes
    start = np.stack([network.weights for network in networks])
    trained = levenberg_marquardt(problem, sizes, start, iterations=iterations, progress=progress)
    return [network.with_weights(w) for network, w in zip(networks, trained.weights, strict=True)], trained
