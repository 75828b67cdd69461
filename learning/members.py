"""Networks that are trained together: how a batch of them goes on until each has come to its own end."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kincal.learning.network import Sizes
from kincal.learning.normal_equations import Rows


@dataclass(frozen=True)
class Problem:
    """B training tasks of one shape; rows with weight 0 are not there (they may be another task's)."""

    x: np.ndarray  # (B, n, n_in), scaled
    offset: np.ndarray  # (B, n, m)
    gain: np.ndarray | None  # (B, n, m, n_out); None: the identity
    train: np.ndarray  # (B, n) weights
    validate: np.ndarray  # (B, n) weights; all zero: no early stopping

    def alike(self) -> list[np.ndarray]:
        """The members, grouped by how many training and how many validation rows they have."""
        groups = defaultdict(list)
        for member, (train, validate) in enumerate(zip(self.train, self.validate, strict=True)):
            groups[np.count_nonzero(train), np.count_nonzero(validate)].append(member)
        return [np.array(who) for who in groups.values()]

    def rows(self, who: np.ndarray, weights: np.ndarray) -> Rows:
        """Of members that are alike, those of weights (B, n) other than 0.

        Chosen before anything is multiplied: what stands in rows of weight 0 may be no number.
        """
        at = who[:, None], np.stack([np.flatnonzero(weights[k]) for k in who])
        return Rows.of(self.x[at], self.offset[at], None if self.gain is None else self.gain[at], weights[at])


@dataclass(frozen=True)
class Trained:
    weights: np.ndarray  # (B, n_weights)
    train_loss: np.ndarray  # (B,) mean square over training rows
    validation_loss: np.ndarray  # (B,) at the weights returned; NaN without validation
    iterations: int  # the most that a member took
    curve: np.ndarray  # (iterations, 2 B): training and validation losses; a member that has stopped repeats its last


class Members:
    """Networks in training together, all with as many rows: arrays, tensors and lists have one entry a member.

    A trainer adds what else it knows of each, and `advance`.
    """

    def __init__(self, problem: Problem, who: np.ndarray, start: np.ndarray, decay: np.ndarray | None) -> None:
        self.who = who
        self.train, self.validate = problem.rows(who, problem.train), problem.rows(who, problem.validate)
        self.prior = torch.from_numpy(np.array(start[who], dtype=np.float64))
        self.pull = np.zeros(len(who)) if decay is None else np.asarray(decay, dtype=np.float64)[who]
        self.weights, self.best = self.prior.clone(), self.prior.clone()
        self.total = np.maximum(self.train.weight.sum(1).numpy(), 1e-300)
        self.losses = self.best_losses = np.full((len(who), 2), np.nan)  # over training and over validation rows
        self.waiting = np.zeros(len(who), dtype=int)  # iterations in a row without a better one
        self.stopped = np.zeros(len(who), dtype=bool)

    def begin(self, losses: np.ndarray) -> None:
        """The losses (g, 2) at the start. Raises FloatingPointError where one is not a number."""
        if not np.isfinite(losses[:, : 1 + self.stops_early]).all():
            raise FloatingPointError("the network's loss is not a number at the start")
        self.losses, self.best_losses = losses, losses.copy()

    @property
    def stops_early(self) -> bool:
        return self.validate.weight.shape[1] > 0

    def held(self, weights: Tensor, sizes: Sizes) -> np.ndarray:
        """(g,) mean squares over validation rows; NaN without such."""
        if not self.stops_early:
            return np.full(len(self.who), np.nan)
        return (self.validate.squares(weights, sizes) / self.validate.weight.sum(1)).numpy()

    def advance(self) -> np.ndarray:
        """One step of each member; the numbers of those whose iteration it ended."""
        raise NotImplementedError

    def judge(self, candidates: np.ndarray, ended: np.ndarray) -> None:
        """Of the members' weights, the best are kept: (g,) which may be, and whose iteration has ended."""
        by = 1 if self.stops_early else 0
        improved = candidates & (self.losses[:, by] < self.best_losses[:, by])  # false for what is no number
        self.best = torch.where(torch.from_numpy(improved)[:, None], self.weights, self.best)
        self.best_losses[improved] = self.losses[improved]
        self.waiting = np.where(improved, 0, self.waiting + ended)

    def keep(self, members: np.ndarray) -> None:
        """The others are computed no further."""
        chosen = np.flatnonzero(members)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(self, name, value[chosen])
            elif isinstance(value, Tensor | Rows):
                setattr(self, name, value[torch.from_numpy(chosen)])
            elif isinstance(value, list):
                setattr(self, name, [value[k] for k in chosen])


def train_all(members: Sequence[Members], progress: Callable[[int, float], None]) -> Trained:
    """Every member to its end. progress: iterations done by those who have done most, and the mean loss."""
    groups, count = list(members), sum(len(group.who) for group in members)
    weights, losses = np.empty((count, groups[0].weights.shape[1])), np.empty((count, 2))
    curves: list[list[np.ndarray]] = [[] for _ in range(count)]
    latest, done = np.zeros(count), 0
    while groups:
        for group in groups:
            for k in group.advance():
                curves[group.who[k]].append(group.losses[k].copy())
            latest[group.who] = group.losses[:, 0]
            if group.stopped.any():
                weights[group.who[group.stopped]] = group.best[torch.from_numpy(group.stopped)]
                losses[group.who[group.stopped]] = group.best_losses[group.stopped]
                group.keep(~group.stopped)
        groups = [group for group in groups if len(group.who)]
        if max(map(len, curves)) > done:
            done = max(map(len, curves))
            progress(done, float(latest.mean()))
    ended = [np.array(c or [last])[np.minimum(np.arange(done), max(len(c) - 1, 0))]
             for c, last in zip(curves, losses, strict=True)]  # fmt: skip
    return Trained(weights, losses[:, 0], losses[:, 1], done, np.stack(ended, axis=2).reshape(done, 2 * count))
