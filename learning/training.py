"""Levenberg-Marquardt in float64 over a batch of networks at once, with early stopping.

Minimises sum |offset + gain @ net(x)|^2 + decay * |w - prior|^2. Regression is gain = 1, offset = -y; a network inside
a linearised model has the model's Jacobian for its gain.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from learning.network import Layout
from learning.normal_equations import Rows, Sizes, System, linearised


@dataclass(frozen=True)
class Problem:
    """B training tasks of one shape; rows with weight 0 are not there (they may be another task's)."""

    x: np.ndarray  # (B, n, n_in), scaled
    offset: np.ndarray  # (B, n, m)
    gain: np.ndarray | None  # (B, n, m, n_out); None: the identity
    train: np.ndarray  # (B, n) weights
    validate: np.ndarray  # (B, n) weights; all zero: no early stopping

    def groups(self) -> list[tuple[np.ndarray, Rows, Rows]]:
        """Members that have as many training and as many validation rows, and these rows alone."""
        alike = defaultdict(list)
        for member, (train, validate) in enumerate(zip(self.train, self.validate, strict=True)):
            alike[np.count_nonzero(train), np.count_nonzero(validate)].append(member)
        return [(np.array(who), self._rows(who, self.train), self._rows(who, self.validate)) for who in alike.values()]

    def _rows(self, who: list[int], weights: np.ndarray) -> Rows:
        """Chosen before anything is multiplied: what stands in rows of weight 0 may be no number."""
        kept = np.stack([np.flatnonzero(weights[k]) for k in who])
        at = np.array(who)[:, None], kept
        return Rows.of(self.x[at], self.offset[at], None if self.gain is None else self.gain[at], weights[at])


@dataclass(frozen=True)
class Trained:
    weights: np.ndarray  # (B, n_weights)
    train_loss: np.ndarray  # (B,) mean square over training rows
    validation_loss: np.ndarray  # (B,) at the weights returned; NaN without validation
    iterations: int  # the most that a member took
    curve: np.ndarray  # (iterations, 2 B): training and validation losses; a member that has stopped repeats its last

    @staticmethod
    def of(weights: np.ndarray, losses: np.ndarray, curves: list[list[tuple[float, float]]]) -> Trained:
        """losses: (B, 2) at the weights; curves: of each member."""
        iterations = max((len(curve) for curve in curves), default=0)
        ended = [np.array(c or [last])[np.minimum(np.arange(iterations), max(len(c) - 1, 0))]
                 for c, last in zip(curves, losses, strict=True)]  # fmt: skip
        curve = np.stack(ended, axis=2).reshape(iterations, 2 * len(curves))
        return Trained(weights, losses[:, 0], losses[:, 1], iterations, curve)


_DAMPING = (1e-3, 1e-12, 1e10)  # start, least, most
_LEAST_FALL = 1e-9  # of the loss in an iteration: less is the end


def levenberg_marquardt(
    problem: Problem,
    layout: Layout,
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
    prior = torch.from_numpy(np.array(start, dtype=np.float64))
    pull = np.zeros(len(start)) if decay is None else np.asarray(decay, dtype=np.float64)
    groups = [
        _Group(layout.sizes, patience, iterations, train, validate, who, prior[who], pull[who])
        for who, train, validate in problem.groups()
    ]
    weights, losses = np.empty(prior.shape), np.empty((len(start), 2))
    curves: list[list[tuple[float, float]]] = [[] for _ in start]
    latest, done = np.zeros(len(start)), 0
    while groups:
        for group in groups:
            for k in group.advance():
                curves[group.who[k]].append((float(group.loss[k] / group.total[k]), float(group.held[k])))
            latest[group.who] = group.loss
            stopped = group.stopped
            if stopped.any():
                weights[group.who[stopped]] = group.best[torch.from_numpy(stopped)]
                losses[group.who[stopped]] = group.best_losses[stopped]
                group.keep(~stopped)
        groups = [group for group in groups if len(group.who)]
        if max(map(len, curves)) > done:
            done = max(map(len, curves))
            progress(done, float(latest.mean()))
    return Trained.of(weights, losses, curves)


class _Group:
    """Members still in training, all with as many rows; arrays of one entry or row a member."""

    def __init__(
        self,
        sizes: Sizes,
        patience: int,
        iterations: int,
        train: Rows,
        validate: Rows,
        who: np.ndarray,
        prior: Tensor,
        pull: np.ndarray,
    ) -> None:
        self.sizes, self.patience, self.iterations = sizes, patience, iterations
        self.train, self.validate, self.who, self.prior, self.pull = train, validate, who, prior, pull
        self.total = np.maximum(train.weight.sum(1).numpy(), 1e-300)
        self.weights, self.best = prior.clone(), prior.clone()
        self.loss, self.held = self._losses(prior)
        if not np.isfinite(self.loss).all() or (self._stops_early and not np.isfinite(self.held).all()):
            raise FloatingPointError("the network's loss is not a number at the start")
        self.best_losses = np.stack([self.loss / self.total, self.held], axis=1)
        self.damping = np.full(len(who), _DAMPING[0])
        self.waiting, self.done = np.zeros(len(who), dtype=int), np.zeros(len(who), dtype=int)
        self.stopped = np.zeros(len(who), dtype=bool)
        self.systems: list[System | None] = [None] * len(who)

    @property
    def _stops_early(self) -> bool:
        return self.validate.weight.shape[1] > 0

    def _losses(self, weights: Tensor) -> tuple[np.ndarray, np.ndarray]:
        """The sum that is minimised, and the mean square over validation rows; (g,) each."""
        penalty = self.pull * ((weights - self.prior) ** 2).sum(1).numpy()
        loss = self.train.squares(weights, self.sizes).numpy() + penalty
        if not self._stops_early:
            return loss, np.full(len(loss), np.nan)
        return loss, (self.validate.squares(weights, self.sizes) / self.validate.weight.sum(1)).numpy()

    def advance(self) -> np.ndarray:
        """One trial step of each member; those whose iteration it ended. A refused one keeps its linearisation."""
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
        loss, held = self._losses(trial)
        better = solved & (loss < self.loss)  # false for what is no number
        self.damping = np.clip(np.where(better, self.damping / 10, self.damping * 10), *_DAMPING[1:])
        given_up = ~better & (self.damping >= _DAMPING[2])
        at_rest = better & (self.loss - loss < _LEAST_FALL * self.loss)
        self.systems = [None if b else system for b, system in zip(better, self.systems, strict=True)]
        self.weights = torch.where(torch.from_numpy(better)[:, None], trial, self.weights)
        self.loss, self.held = np.where(better, loss, self.loss), np.where(better, held, self.held)
        improved = better & (held < self.best_losses[:, 1]) if self._stops_early else better
        self.best = torch.where(torch.from_numpy(improved)[:, None], trial, self.best)
        self.best_losses[improved] = np.stack([loss / self.total, held], axis=1)[improved]
        ended = better | given_up
        self.done += ended
        self.waiting = np.where(improved, 0, self.waiting + ended)
        self.stopped = given_up | at_rest | (self.waiting >= self.patience) | (self.done >= self.iterations)
        return np.flatnonzero(ended)

    def keep(self, members: np.ndarray) -> None:
        """The others are computed no further."""
        for name in ("who", "pull", "total", "loss", "held", "best_losses", "damping", "waiting", "done", "stopped"):
            setattr(self, name, getattr(self, name)[members])
        chosen = torch.from_numpy(np.flatnonzero(members))
        for name in ("prior", "weights", "best", "train", "validate"):
            setattr(self, name, getattr(self, name)[chosen])
        self.systems = [self.systems[k] for k in chosen]
