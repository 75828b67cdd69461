"""Nonlinear least squares over the parameters: Levenberg-Marquardt, exact derivatives, loops re-closed each step.

Minimises loss(r(p)) + |p / sigma|^2 / 2. Each step is solved by the singular values of the stacked, scaled Jacobian
(its QR factor), never by normal equations: they square the condition number. Directions that neither data nor a prior
can see (W's turn about gravity, for tilt alone) take no step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from kincal.identification.error_model import ErrorModel, Linearisation
from kincal.identification.measurements import Measurements
from kincal.identification.robust_loss import Loss
from kincal.identification.singular_values import svd
from kincal.urdf.errors import CalibrationError

NULL = 1e-11  # relative to the largest singular value: below, neither data nor prior see the direction
_PATIENCE = 60  # iterations; then Nielsen's damping alone
_POOR = 0.25  # a step that brings so small a part of what was foretold
_LOPSIDED = 0.25  # a parabola's best step length is off 1 by more: worth a look
_UNTOLD = 1e-2  # of a singular value, in natural sizes of 10 mm and 10 mrad: not told to 1 m or 1 rad is not told
_LEAST = 1e-3  # damping, in units of the priors' own information; less is none
_STEP = 1e-7  # converged: no parameter moves by more than this part of its sigma
_COST = 1e-9  # or the cost falls by less than this part of it ..
_LEVEL = 1e-6  # .. and by less than this in absolute terms


@dataclass(frozen=True)
class Problem:
    """What is minimised, and where p may move."""

    model: ErrorModel
    measured: Measurements
    basis: np.ndarray  # (n_parameters, k): steps are basis @ z, columns of a natural size
    sigma: np.ndarray  # (n_parameters,) of the priors; infinite: none
    loss: Loss = field(default_factory=Loss)

    def linearise(self, p: np.ndarray, start: np.ndarray | None) -> Linearisation | None:
        channels, loss = self.measured.channels, self.loss
        weigh = None if loss.kind == "gaussian" else lambda r: loss.weights(r, channels)
        return self.model.linearise(p, self.measured, start, weigh)

    def cost(self, at: Linearisation, p: np.ndarray) -> float:
        return self.loss.cost(at.residual, self.measured.channels) + 0.5 * float(np.sum((p / self.sigma) ** 2))


@dataclass(frozen=True)
class Solution:
    p: np.ndarray  # (n_parameters,)
    at: Linearisation
    cost: float
    iterations: int
    success: bool
    message: str


def minimise(problem: Problem, p: np.ndarray, q: np.ndarray, max_iterations: int) -> Solution:
    """From parameters p and configurations q: (n, n_joints) near by."""
    start = _at(problem, p, q)
    if start is None:
        raise CalibrationError("the loops can't be closed at the start")
    here, message = start, f"not converged after {max_iterations} iterations"
    damping, growth, success, iteration = 0.0, 2.0, False, 0
    while iteration < max_iterations and not success:
        iteration += 1
        z, foretold = _step(problem, here.at, here.p, damping)
        step, small = problem.basis @ z, np.max(np.abs(z)) < _STEP
        trial = _at(problem, here.p + step, here.at.q)
        patient = iteration > _PATIENCE  # a valley so narrow that only small steps follow it
        if trial is not None and not small and not patient:
            # Gauss-Newton overshoots (or falls short) along curved residuals, again and again: look along the step
            length = foretold / max(2 * foretold - (here.cost - trial.cost), 0.1 * foretold, 1e-300)
            other = _at(problem, here.p + length * step, here.at.q) if abs(length - 1) > _LOPSIDED else None
            trial = min(trial, other or trial, key=lambda t: t.cost)
        if trial is not None and trial.cost <= here.cost * (1 + 1e-12):
            fall = here.cost - trial.cost
            success = bool(small or (fall < _COST * here.cost and fall < _LEVEL and damping < _LEAST))
            # Nielsen (1999): the damping follows how well the linear model foretold the fall
            ratio = np.clip(fall / max(foretold, 1e-300), 0.0, 1.0)
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3)
            damping, growth = (damping if damping > _LEAST else 0.0), 2.0
            if ratio < _POOR and not patient:  # a curved valley: shorter steps along what is hardly seen
                damping = max(4 * damping, _LEAST)
            here = trial
        elif small:
            success = True  # the minimum to rounding
        else:
            damping, growth = max(damping, _LEAST) * growth, 2 * growth
    return Solution(here.p, here.at, here.cost, iteration, success, "converged" if success else message)


@dataclass(frozen=True)
class _Point:
    p: np.ndarray
    at: Linearisation
    cost: float


def _at(problem: Problem, p: np.ndarray, start: np.ndarray | None) -> _Point | None:
    """p with the translation of W at its best, linearised; None where the loops can't be closed.

    Positions are linear in it and no other derivative knows it, so this needs no other linearisation. Left to the
    steps, it makes a narrow curved valley: a turn of W moves whatever T's lever arm has traded against W.
    """
    at = problem.linearise(p, start)
    if at is None:
        return None
    if "position" in problem.measured.channels:
        columns = at.triangle[:, len(p) - 12 : len(p) - 9]
        change = -np.linalg.lstsq(columns, at.triangle[:, -1], rcond=None)[0]
        p, triangle = p.copy(), at.triangle.copy()
        p[-12:-9] += change
        triangle[:, -1] += columns @ change
        at = replace(at, residual=at.residual + at.by_instrument @ change, triangle=triangle)
    return _Point(p, at, problem.cost(at, p))


def _step(problem: Problem, at: Linearisation, p: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """The damped step z, and how far it would bring the cost down if the model were linear."""
    data, n = at.triangle @ np.pad(problem.basis, ((0, 1), (0, 0))), len(p)
    bound = np.isfinite(problem.sigma)
    prior = problem.basis[bound] / problem.sigma[bound, None]
    matrix = np.concatenate([data, prior])
    right = np.concatenate([at.triangle[:, n], p[bound] / problem.sigma[bound]])
    triangle = np.asarray(np.linalg.qr(np.column_stack([matrix, right]), mode="r"))
    u, singular, vt = svd(triangle[:, :-1])
    along = u.T @ triangle[:, -1]
    seen = singular > max(NULL * singular[0], _UNTOLD)
    gain = np.where(seen, singular / (singular**2 + damping + (~seen)), 0.0)
    shrunk = gain * singular
    return -(vt.T @ (gain * along)), 0.5 * float(np.sum((1 - (1 - shrunk) ** 2) * along**2))
