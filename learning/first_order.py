"""Adam in float64 over a batch of networks at once: for networks too large for Levenberg-Marquardt's linear systems.

The same problem, result and early stopping. It gets near a minimum, Levenberg-Marquardt into it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from kincal.learning.members import Members, Problem, Trained, train_all
from kincal.learning.network import Sizes
from kincal.learning.normal_equations import descent

_MEMORY = (0.9, 0.999)  # of the mean gradient and of its mean square
_TINY = 1e-12  # beside the root of the mean square: gradients fall far below Adam's usual 1e-8
_LEAST_RATE = 1e-3  # of the first one, at the end


def adam(
    problem: Problem,
    sizes: Sizes,
    start: np.ndarray,
    *,
    iterations: int,
    rate: float = 1e-2,
    patience: int = 200,
    decay: np.ndarray | None = None,
    progress: Callable[[int, float], None] = lambda done, loss: None,
) -> Trained:
    """Train from start: (B, n_weights) by full-batch Adam (Kingma and Ba 2015), the rate falling as a cosine.

    Early stopping: `patience` iterations in a row without a better validation; without validation rows the least loss
    counts. The best weights come back. decay: (B,) strength of the pull towards `start`. Raises FloatingPointError
    where a loss is not a number at the start; a member whose loss becomes none ends at its best. Deterministic on one
    thread; a member's result is its own, as in levenberg_marquardt.
    """
    groups = [_Moments(problem, who, sizes, start, decay, patience, iterations, rate) for who in problem.alike()]
    return train_all(groups, progress)


class _Moments(Members):
    """Each member with the mean of its gradients and of their squares."""

    def __init__(
        self,
        problem: Problem,
        who: np.ndarray,
        sizes: Sizes,
        start: np.ndarray,
        decay: np.ndarray | None,
        patience: int,
        iterations: int,
        rate: float,
    ) -> None:
        super().__init__(problem, who, start, decay)
        self.sizes, self.patience, self.iterations, self.rate, self.done = sizes, patience, iterations, rate, 0
        self.mean, self.mean_square = torch.zeros_like(self.prior), torch.zeros_like(self.prior)
        losses, self.gradient = self._descent()
        self.begin(losses)

    def _descent(self) -> tuple[np.ndarray, Tensor]:
        """Mean squares over training rows, with the pull, and over validation rows (g, 2); the first one's gradient."""
        square, gradient = descent(self.weights, self.sizes, self.train)
        away, pull, total = self.weights - self.prior, torch.from_numpy(self.pull), torch.from_numpy(self.total)
        loss = (square + (pull[:, None] * away**2).sum(1)) / total
        gradient = 2 * (gradient + pull[:, None] * away) / total[:, None]
        return np.stack([loss.numpy(), self.held(self.weights, self.sizes)], axis=1), gradient

    def advance(self) -> np.ndarray:
        rate = self.rate * (_LEAST_RATE + (1 - _LEAST_RATE) * (1 + np.cos(np.pi * self.done / self.iterations)) / 2)
        self.done += 1
        self.mean.lerp_(self.gradient, 1 - _MEMORY[0])
        self.mean_square.lerp_(self.gradient**2, 1 - _MEMORY[1])
        mean, square = self.mean / (1 - _MEMORY[0] ** self.done), self.mean_square / (1 - _MEMORY[1] ** self.done)
        self.weights = self.weights - rate * mean / (square.sqrt() + _TINY)
        self.losses, self.gradient = self._descent()
        everyone = np.ones(len(self.who), dtype=bool)
        self.judge(everyone, everyone)
        over = self.done >= self.iterations
        self.stopped = (self.waiting >= self.patience) | ~np.isfinite(self.losses[:, 0]) | over
        return np.arange(len(self.who))
