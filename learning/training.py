"""Levenberg-Marquardt in float64 over a batch of networks at once, with early stopping.

Minimises sum |offset + gain @ net(x)|^2 + decay * |w - prior|^2. Regression is gain = 1, offset = -y; a network inside
a linearised model has the model's Jacobian for its gain. Normal equations by Cholesky: batched `torch.linalg.solve`
fails on such sizes in torch 2.13.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from learning.network import Layout, split


@dataclass(frozen=True)
class Problem:
    """B training tasks of one shape; rows with weight 0 are not there (they may be another task's)."""

    x: np.ndarray  # (B, n, n_in), scaled
    offset: np.ndarray  # (B, n, m)
    gain: np.ndarray | None  # (B, n, m, n_out); None: the identity
    train: np.ndarray  # (B, n) weights
    validate: np.ndarray  # (B, n) weights; all zero: no early stopping


@dataclass(frozen=True)
class Trained:
    weights: np.ndarray  # (B, n_weights)
    train_loss: np.ndarray  # (B,) mean square over training rows
    validation_loss: np.ndarray  # (B,) at the weights returned; NaN without validation
    iterations: int
    curve: np.ndarray  # (iterations, 2 B): training and validation losses


_DAMPING = (1e-3, 1e-12, 1e10)  # start, least, most


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
    """
    x, offset, train, validate = (torch.from_numpy(np.ascontiguousarray(v, dtype=np.float64)) for v in
                                  (problem.x, problem.offset, problem.train, problem.validate))  # fmt: skip
    gain = None if problem.gain is None else torch.from_numpy(np.ascontiguousarray(problem.gain, dtype=np.float64))
    active = torch.from_numpy(np.flatnonzero(layout.mask))
    prior = torch.from_numpy(np.array(start, dtype=np.float64))
    pull = (
        torch.zeros(len(x), dtype=torch.float64) if decay is None else torch.from_numpy(np.asarray(decay, dtype=float))
    )
    weights, damping = prior.clone(), torch.full((len(x),), _DAMPING[0], dtype=torch.float64)

    def losses(w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        square = (_errors(w, layout, x, offset, gain) ** 2).sum(-1)
        penalty = pull * ((w - prior) ** 2).sum(-1)
        return (square * train).sum(-1) + penalty, (square * validate).sum(-1) / validate.sum(-1)

    loss, held = losses(weights)
    if not torch.isfinite(loss).all():
        raise FloatingPointError("the network's loss is not a number at the start")
    best, best_held, waiting = weights.clone(), held.clone(), torch.zeros(len(x))
    stopping = bool(problem.validate.any())
    running, curve, done = torch.ones(len(x), dtype=torch.bool), [], 0
    for done in range(1, iterations + 1):
        gradient, normal = _normal_equations(weights, layout, x, offset, gain, train, active)
        gradient = gradient + pull[:, None] * (weights - prior)[:, active]
        diagonal = torch.diagonal(normal, dim1=-2, dim2=-1)
        diagonal += pull[:, None]
        for _ in range(12):
            lifted = normal.clone()
            torch.diagonal(lifted, dim1=-2, dim2=-1).add_(damping[:, None] * diagonal.mean(-1, keepdim=True))
            factor, info = torch.linalg.cholesky_ex(lifted)
            step = torch.cholesky_solve(gradient[..., None], factor)[..., 0]
            trial = weights.clone()
            trial[:, active] -= step
            trial_loss, trial_held = losses(trial)
            better = running & (info == 0) & (trial_loss < loss)
            damping = torch.where(better, damping / 10, damping * 10).clamp(_DAMPING[1], _DAMPING[2])
            if (better | ~running | (damping >= _DAMPING[2])).all():
                break
            if better.any():
                break
        fallen = (loss - trial_loss) / loss
        weights = torch.where(better[:, None], trial, weights)
        loss, held = torch.where(better, trial_loss, loss), torch.where(better, trial_held, held)
        improved = held < best_held if stopping else better
        best = torch.where((improved & running)[:, None], weights, best)
        best_held = torch.where(improved & running, held, best_held)
        waiting = torch.where(improved, 0.0, waiting + 1)
        running &= ~(damping >= _DAMPING[2]) & (waiting < patience) & ~(better & (fallen < 1e-9))
        curve.append(torch.cat([loss / train.sum(-1), held]).numpy())
        progress(done, float(loss.mean()))
        if not running.any():
            break
    final, held = losses(best)
    return Trained(best.numpy(), (final / train.sum(-1)).numpy(), held.numpy(), done, np.array(curve))


def _errors(weights, layout: Layout, x, offset, gain) -> torch.Tensor:
    w1, b1, w2, b2, w3, b3 = split(weights, layout.sizes)
    first = torch.tanh(torch.baddbmm(b1[:, None], x, w1.mT))
    second = torch.tanh(torch.baddbmm(b2[:, None], first, w2.mT))
    y = torch.baddbmm(b3[:, None], second, w3.mT)
    return offset + (y if gain is None else (gain @ y[..., None])[..., 0])


def _normal_equations(weights, layout: Layout, x, offset, gain, train, active) -> tuple[torch.Tensor, torch.Tensor]:
    """J^T W e (B, n_active) and J^T W J (B, n_active, n_active), J of the errors by the weights, in closed form."""
    w1, b1, w2, b2, w3, b3 = split(weights, layout.sizes)
    first = torch.tanh(torch.baddbmm(b1[:, None], x, w1.mT))
    second = torch.tanh(torch.baddbmm(b2[:, None], first, w2.mT))
    y = torch.baddbmm(b3[:, None], second, w3.mT)
    error = offset + (y if gain is None else (gain @ y[..., None])[..., 0])
    batch, n, _ = x.shape
    n_out = layout.sizes[-1]
    root = train.sqrt()[:, :, None]
    # outer[b, n, m, k]: d error_m / d y_k, weighted; all else is a product with it
    outer = torch.eye(n_out, dtype=x.dtype).expand(batch, n, n_out, n_out) if gain is None else gain
    outer = outer * root[..., None]
    to_second = (outer @ w3[:, None]) * (1 - second**2)[:, :, None]  # d error / d (input of layer 2)
    to_first = (to_second @ w2[:, None]) * (1 - first**2)[:, :, None]
    jacobian = torch.empty(batch, n, outer.shape[2], weights.shape[-1], dtype=x.dtype)
    start = 0
    for factor, inputs in ((to_first, x), (to_second, first), (outer, second)):
        rows, columns = factor.shape[-1], inputs.shape[-1]
        block = jacobian[..., start : start + rows * columns].unflatten(-1, (rows, columns))
        torch.mul(factor[..., None], inputs[:, :, None, None, :], out=block)
        start += rows * columns
        jacobian[..., start : start + rows] = factor
        start += rows
    if len(active) < jacobian.shape[-1]:
        jacobian = jacobian[..., active]
    jacobian = jacobian.reshape(batch, -1, jacobian.shape[-1])
    return (jacobian.mT @ (error * root).reshape(batch, -1, 1))[..., 0], jacobian.mT @ jacobian
