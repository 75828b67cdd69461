"""The four-layer network of Xu, Tian and Zhang (2024, eq. 5): n_in - H - H - n_out, tanh, float64.

Used in numpy, trained in torch: who predicts need not wait for torch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Layout:
    """Layer sizes, and which weights exist: a mask over the flat weight vector."""

    sizes: tuple[int, int, int, int]
    mask: np.ndarray  # (n_weights,) bool

    @staticmethod
    def dense(n_in: int, hidden: int, n_out: int) -> Layout:
        sizes = (n_in, hidden, hidden, n_out)
        return Layout(sizes, np.ones(count(sizes), dtype=bool))

    @staticmethod
    def joint_wise(n_joints: int, own: int, shared: int) -> Layout:
        """For each joint `own` hidden units that see it alone and move it alone, and `shared` ones from all to all.

        Screw and gear errors are functions of their own joint; loads couple the joints.
        """
        hidden = n_joints * own + shared
        owner = np.concatenate([np.repeat(np.arange(n_joints), own), np.full(shared, -1)])
        joint = np.arange(n_joints)
        first = (owner[:, None] == joint) | (owner[:, None] == -1)
        second = owner[:, None] == owner
        third = (joint[:, None] == owner) | (owner == -1)
        bias = np.ones(hidden, dtype=bool)
        parts = [first.ravel(), bias, second.ravel(), bias, third.ravel(), np.ones(n_joints, dtype=bool)]
        return Layout((n_joints, hidden, hidden, n_joints), np.concatenate(parts))


@dataclass(frozen=True)
class Network:
    """y = output_scale * net((x - input_centre) / input_scale)."""

    sizes: tuple[int, int, int, int]
    weights: np.ndarray  # (n_weights,)
    input_centre: np.ndarray  # (n_in,)
    input_scale: np.ndarray  # (n_in,)
    output_scale: np.ndarray  # (n_out,)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(n, n_out) at x: (n, n_in)."""
        w1, b1, w2, b2, w3, b3 = split(self.weights, self.sizes)
        first = np.tanh(self.scaled(x) @ w1.T + b1)
        return self.output_scale * (np.tanh(first @ w2.T + b2) @ w3.T + b3)

    def scaled(self, x: np.ndarray) -> np.ndarray:
        return (x - self.input_centre) / self.input_scale

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(n, n_out, n_in): dy / dx."""
        w1, b1, w2, b2, w3, _ = split(self.weights, self.sizes)
        first = np.tanh(self.scaled(x) @ w1.T + b1)
        second = np.tanh(first @ w2.T + b2)
        inner = (1 - first**2)[:, :, None] * w1 / self.input_scale
        return self.output_scale[:, None] * (w3 @ ((1 - second**2)[:, :, None] * (w2 @ inner)))

    def with_weights(self, weights: np.ndarray) -> Network:
        return replace(self, weights=weights)


def count(sizes: tuple[int, int, int, int]) -> int:
    n_in, first, second, n_out = sizes
    return first * (n_in + 1) + second * (first + 1) + n_out * (second + 1)


def split(weights, sizes: tuple[int, int, int, int]) -> list:
    """Views W1 (H, n_in), b1, W2 (H, H), b2, W3 (n_out, H), b3 of flat weights (..., n_weights); numpy or torch."""
    found, start = [], 0
    for n_in, n_out in pairwise(sizes):
        found.append(weights[..., start : start + n_out * n_in].reshape(*weights.shape[:-1], n_out, n_in))
        start += n_out * n_in
        found.append(weights[..., start : start + n_out])
        start += n_out
    return found


def initial_weights(layout: Layout, random: np.random.Generator, zero_output: bool = False) -> np.ndarray:
    """(n_weights,) after Nguyen and Widrow (1990): hidden units spread over scaled inputs in [-1, 1].

    zero_output: the network starts as the zero function.
    """
    weights = np.zeros(count(layout.sizes))
    weights[layout.mask] = random.uniform(-1, 1, int(layout.mask.sum()))
    w1, b1, w2, b2, w3, b3 = split(weights, layout.sizes)
    for w, b in ((w1, b1), (w2, b2)):
        fan_in = np.maximum(np.count_nonzero(w, axis=1), 1)
        # units that see the same inputs share their range
        alike = np.array([np.sum(np.all((w != 0) == (row != 0), axis=1)) for row in w])
        length = 0.7 * alike ** (1 / fan_in)
        w *= (length / np.maximum(np.linalg.norm(w, axis=1), 1e-12))[:, None]
        b *= length
    w3 /= np.sqrt(np.maximum(np.count_nonzero(w3, axis=1), 1))[:, None]
    b3 *= 0.1
    if zero_output:
        w3[:], b3[:] = 0.0, 0.0
    return weights
