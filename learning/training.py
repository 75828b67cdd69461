"""Levenberg-Marquardt in float64 over a batch of networks at once, with early stopping.

Minimises sum |offset + gain @ net(x)|^2 + decay * |w - prior|^2. Regression is gain = 1, offset = -y; a network inside
a linearised model has the model's Jacobian for its gain.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from kincal.learning.members import Members, Problem, Trained, train_all
from kincal.learning.network import Sizes
from kincal.learning.normal_equations import System, linearised

_DAMPING = (1e-3, 1e-12, 1e10)  # start, least, most
# Delayed gratification (Transtrum and Sethna 2012): a refused step raises the damping by little, an accepted one lowers
# it by much; not by so much after a refused one, whose damping is near what the next step needs.
_RAISED, _LOWERED, _AFTER_REFUSAL = 2.0, 0.05, 0.25
_LEAST_FALL = 1e-9  # of the loss in an iteration: less is the end


def levenberg_marquardt(
    problem: Problem,
    sizes: Sizes,
    start: np.ndarray,
    *,
    iterations: int,
    patience: int = 6,
    decay: np.ndarray | None = None,
    progress: Callable[[int, float], None] = lambda done, loss: None,
) -> Trained:
    """Train from start: (B, n_weights). Early stopping: `patience` iterations in a row without a better validation.

    decay: (B,) strength of the pull towards `start`. Raises FloatingPointError where a loss is not a number.

    Each member has its own damping, iterations and end; an iteration is a linearisation and as many trial steps as it
    takes. One that is no number is refused like one that leads up. The same input gives the same output to the last
    bit on one thread; a member's result does not depend on who else is in the batch, but for the rounding of torch's
    batched products (measured: none).
    """
    groups = [_Damped(problem, who, sizes, start, decay, patience, iterations) for who in problem.alike()]
    return train_all(groups, progress)


class _Damped(Members):
    """Each member with the damping, and the linearisation that its next trial step is solved from."""

    def __init__(
        self,
        problem: Problem,
        who: np.ndarray,
        sizes: Sizes,
        start: np.ndarray,
        decay: np.ndarray | None,
        patience: int,
        iterations: int,
    ) -> None:
        super().__init__(problem, who, start, decay)
        self.sizes, self.patience, self.iterations = sizes, patience, iterations
        self.begin(self._losses(self.prior))
        self.damping, self.done = np.full(len(who), _DAMPING[0]), np.zeros(len(who), dtype=int)
        self.refused = np.zeros(len(who), dtype=bool)  # the last trial step
        self.systems: list[System | None] = [None] * len(who)

    def _losses(self, weights: Tensor) -> np.ndarray:
        """(g, 2): what is minimised, over the weight of the training rows; the mean square over validation rows."""
        penalty = self.pull * ((weights - self.prior) ** 2).sum(1).numpy()
        loss = (self.train.squares(weights, self.sizes).numpy() + penalty) / self.total
        return np.stack([loss, self.held(weights, self.sizes)], axis=1)

    def advance(self) -> np.ndarray:
        """One trial step of each member; a refused one keeps its linearisation."""
        if not self.train.weight.shape[1]:  # nothing to learn from
            self.stopped[:] = True
            return np.flatnonzero(~self.stopped)
        fresh = [k for k, system in enumerate(self.systems) if system is None]
        if fresh:
            everyone = len(fresh) == len(self.systems)
            rows = self.train if everyone else self.train[torch.tensor(fresh)]
            for k, system in zip(fresh, linearised(self.weights[fresh], self.sizes, rows), strict=True):
                self.systems[k] = system
        trial, away, solved = self.weights.clone(), self.weights - self.prior, np.zeros(len(self.who), dtype=bool)
        for k, system in enumerate(self.systems):
            assert system is not None
            step = system.step(self.damping[k], self.pull[k], away[k])
            if step is not None:
                trial[k] -= step
                solved[k] = True
        losses, before = self._losses(trial), self.losses[:, 0]
        better = solved & (losses[:, 0] < before)  # false for what is no number
        lowered = np.where(self.refused, _AFTER_REFUSAL, _LOWERED)
        self.damping = np.clip(self.damping * np.where(better, lowered, _RAISED), *_DAMPING[1:])
        self.refused = ~better
        given_up = ~better & (self.damping >= _DAMPING[2])
        at_rest = better & (before - losses[:, 0] < _LEAST_FALL * before)
        self.systems = [None if b else system for b, system in zip(better, self.systems, strict=True)]
        self.weights = torch.where(torch.from_numpy(better)[:, None], trial, self.weights)
        self.losses = np.where(better[:, None], losses, self.losses)
        ended = better | given_up
        self.judge(better, ended)
        self.done += ended
        self.stopped = given_up | at_rest | (self.waiting >= self.patience) | (self.done >= self.iterations)
        return np.flatnonzero(ended)
