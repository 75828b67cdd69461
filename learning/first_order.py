"""Adam in float64 over a batch of networks at once: for networks too large for Levenberg-Marquardt's linear systems.

The same problem, result and early stopping. It gets near a minimum, Levenberg-Marquardt into it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from learning.network import Layout
from learning.normal_equations import Rows, Sizes, descent
from learning.training import Problem, Trained

_MEMORY = (0.9, 0.999)  # of the mean gradient and of its mean square
_TINY = 1e-12  # beside the root of the mean square: gradients fall far below Adam's usual 1e-8
_LEAST_RATE = 1e-3  # of the first one, at the end


def adam(
    problem: Problem,
    layout: Layout,
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
    prior = torch.from_numpy(np.array(start, dtype=np.float64))
    pull = torch.zeros(len(prior)) if decay is None else torch.from_numpy(np.asarray(decay, dtype=np.float64))
    groups = [
        _Group(layout.sizes, train, validate, who, prior[who], pull[who]) for who, train, validate in problem.groups()
    ]
    weights, losses = np.empty(prior.shape), np.empty((len(start), 2))
    curves: list[list[tuple[float, float]]] = [[] for _ in start]
    latest = np.zeros(len(start))
    for done in range(1, iterations + 1):
        falling = _LEAST_RATE + (1 - _LEAST_RATE) * (1 + np.cos(np.pi * (done - 1) / iterations)) / 2
        for group in groups:
            group.advance(done, rate * falling)
            for member, now in zip(group.who, group.losses, strict=True):
                curves[member].append((float(now[0]), float(now[1])))
            latest[group.who] = group.losses[:, 0]
            stopped = (group.waiting >= patience) | ~np.isfinite(group.losses[:, 0]) | (done == iterations)
            if stopped.any():
                weights[group.who[stopped]] = group.best[torch.from_numpy(stopped)]
                losses[group.who[stopped]] = group.best_losses[stopped]
                group.keep(~stopped)
        groups = [group for group in groups if len(group.who)]
        progress(done, float(latest.mean()))
        if not groups:
            break
    return Trained.of(weights, losses, curves)


class _Group:
    """Members still in training, all with as many rows; arrays of one row or entry a member."""

    def __init__(
        self,
        sizes: Sizes,
        train: Rows,
        validate: Rows,
        who: np.ndarray,
        prior: Tensor,
        pull: Tensor,
    ) -> None:
        self.sizes, self.train, self.validate, self.who = sizes, train, validate, who
        self.prior, self.pull = prior, pull[:, None]
        self.weights, self.best = prior.clone(), prior.clone()
        self.mean, self.mean_square = torch.zeros_like(prior), torch.zeros_like(prior)
        self.losses, self.gradient = self._descent()
        self.best_losses = self.losses.copy()
        self.waiting = np.zeros(len(who), dtype=int)
        if not np.isfinite(self.losses[:, : 1 + self._stops_early]).all():
            raise FloatingPointError("the network's loss is not a number at the start")

    @property
    def _stops_early(self) -> bool:
        return self.validate.weight.shape[1] > 0

    def _descent(self) -> tuple[np.ndarray, Tensor]:
        """Mean squares over training rows, with the pull, and over validation rows (g, 2); the first one's gradient."""
        square, gradient = descent(self.weights, self.sizes, self.train)
        away, total = self.weights - self.prior, self.train.weight.sum(1).clamp(min=1e-300)
        loss = (square + (self.pull * away**2).sum(1)) / total
        gradient = 2 * (gradient + self.pull * away) / total[:, None]
        held = torch.full_like(loss, np.nan)
        if self._stops_early:
            held = self.validate.squares(self.weights, self.sizes) / self.validate.weight.sum(1)
        return torch.stack([loss, held], dim=1).numpy(), gradient

    def advance(self, done: int, rate: float) -> None:
        self.mean.lerp_(self.gradient, 1 - _MEMORY[0])
        self.mean_square.lerp_(self.gradient**2, 1 - _MEMORY[1])
        mean, square = self.mean / (1 - _MEMORY[0] ** done), self.mean_square / (1 - _MEMORY[1] ** done)
        self.weights = self.weights - rate * mean / (square.sqrt() + _TINY)
        self.losses, self.gradient = self._descent()
        judge = 1 if self._stops_early else 0
        improved = self.losses[:, judge] < self.best_losses[:, judge]  # false for what is no number
        self.best = torch.where(torch.from_numpy(improved)[:, None], self.weights, self.best)
        self.best_losses[improved] = self.losses[improved]
        self.waiting = np.where(improved, 0, self.waiting + 1)

    def keep(self, members: np.ndarray) -> None:
        """The others are computed no further."""
        for name in ("who", "losses", "best_losses", "waiting"):
            setattr(self, name, getattr(self, name)[members])
        chosen = torch.from_numpy(np.flatnonzero(members))
        for name in ("prior", "pull", "weights", "best", "mean", "mean_square", "gradient", "train", "validate"):
            setattr(self, name, getattr(self, name)[chosen])
