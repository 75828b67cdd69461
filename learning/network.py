"""The four-layer network of Xu, Tian and Zhang (2024, eq. 5): n_in - H - H - n_out, tanh, float64.

Used in numpy, trained in torch: who predicts need not wait for torch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

Sizes = tuple[int, int, int, int]  # n_in, H, H, n_out


@dataclass(frozen=True)
class Network:
    """y = output_scale * net((x - input_centre) / input_scale)."""

    sizes: Sizes
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


def count(sizes: Sizes) -> int:
    n_in, first, second, n_out = sizes
    return first * (n_in + 1) + second * (first + 1) + n_out * (second + 1)


def split(weights, sizes: Sizes) -> list:
    """Views W1 (H, n_in), b1, W2 (H, H), b2, W3 (n_out, H), b3 of flat weights (..., n_weights); numpy or torch."""
    parts, start = [], 0
    for n_in, n_out in pairwise(sizes):
        parts.append(weights[..., start : start + n_out * n_in].reshape(*weights.shape[:-1], n_out, n_in))
        start += n_out * n_in
        parts.append(weights[..., start : start + n_out])
        start += n_out
    return parts


def initial_weights(sizes: Sizes, random: np.random.Generator) -> np.ndarray:
    """(n_weights,) after Nguyen and Widrow (1990): hidden units spread over scaled inputs in [-1, 1]."""
    weights = random.uniform(-1, 1, count(sizes))
    w1, b1, w2, b2, w3, b3 = split(weights, sizes)
    for w, b in ((w1, b1), (w2, b2)):
        units, fan_in = w.shape
        length = 0.7 * units ** (1 / fan_in)
        w *= (length / np.maximum(np.linalg.norm(w, axis=1), 1e-12))[:, None]
        b *= length
    w3 /= np.sqrt(w3.shape[1])
    b3 *= 0.1
    return weights
