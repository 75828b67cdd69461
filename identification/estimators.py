"""Maximum a posteriori estimation of all parameters, by Levenberg-Marquardt with exact derivatives.

Minimises |r(p) / sigma|^2 + |p / tolerance|^2. Each step is solved by the singular values of the stacked, scaled
Jacobian (its QR factor), never by normal equations: they square the condition number. Directions that neither data nor
a prior can see (W's turn about gravity, for tilt alone) take no step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification import registration
from identification.error_model import ErrorModel, Linearisation, require_closed
from identification.measurements import Measurements
from urdf.errors import CalibrationError

_FLAT_SCALE = 1e-2  # a natural size for W and T in the scaled Jacobian [m, rad]; decides nothing but rounding
_NULL = 1e-11  # relative to the largest singular value: below, neither data nor prior see the direction
_LEAST = 1e-3  # damping, in units of the priors' own information; less is none
_STEP = 1e-7  # converged: no parameter moves by more than this part of its sigma
_COST = 1e-9  # or the cost falls by less than this part of it ..
_LEVEL = 1e-6  # .. and by less than this in absolute terms


@dataclass(frozen=True)
class Estimate:
    """The words of scipy.optimize, and what a calibration engineer asks for besides."""

    p: np.ndarray  # (n_parameters,) changes from nominal
    covariance: np.ndarray  # (n_parameters, n_parameters); directions that nothing sees are left out of it
    unseen: np.ndarray  # (n_parameters,) bool: the parameter takes part in such a direction: its sigma is infinite
    jacobian: np.ndarray  # (rows, n_parameters) of the whitened residuals, without priors
    residual: np.ndarray  # (rows,) whitened
    q: np.ndarray  # (n, n_joints) the closed configurations of the measured poses
    cost: float  # half the sum of squares, priors included
    iterations: int
    success: bool
    message: str


def register(model: ErrorModel, measured: Measurements, max_iterations: int = 300) -> Estimate:
    """Fit W and T alone to the nominal robot: what `nominal` means.

    Raises InputError for too few poses or loops that can't be closed, CalibrationError where no start converges.
    """
    free = model.parameters.flat
    p = np.zeros(len(model.parameters))
    closure = require_closed(model.robot(p).close(measured.readings), measured)
    found = [
        _minimise(model, measured, model.with_frames(p, w, t), closure.q, free, max_iterations)
        for w, t in registration.starts(closure.pose, measured)
    ]
    return _best(found, "registration of W and T")


def _best(found: list[Estimate], what: str) -> Estimate:
    best = min(found, key=lambda e: e.cost)
    if not best.success:
        raise CalibrationError(f"{what} did not converge: {best.message}")
    return best


def identify(
    model: ErrorModel, measured: Measurements, max_iterations: int = 300, registered: Estimate | None = None
) -> Estimate:
    """All parameters, the manufacturing tolerances as priors; W and T have flat ones and start registered.

    registered: what `register` found on the same measurements, where that is known.
    Raises InputError as `register` does, CalibrationError where the iteration does not converge.
    """
    start = registered or register(model, measured, max_iterations)
    free = np.ones(len(model.parameters), dtype=bool)
    estimate = _minimise(model, measured, start.p, start.q, free, max_iterations, priors=True)
    if not estimate.success:
        raise CalibrationError(f"identification did not converge: {estimate.message}")
    return estimate


def left_out(model: ErrorModel, at: Linearisation, p: np.ndarray, rows: np.ndarray, n: int) -> np.ndarray:
    """Whitened residuals (all rows) of an identification without the poses `rows` of n: one linear step from p."""
    per_pose = len(at.residual) // n
    kept = np.setdiff1d(np.arange(n), rows)
    pick = (kept[:, None] * per_pose + np.arange(per_pose)).ravel()
    sigma = model.parameters.tolerance
    scale = np.where(np.isfinite(sigma), sigma, _FLAT_SCALE)
    seen = Linearisation(at.residual[pick], at.jacobian[pick], at.q[kept])
    return at.residual + at.jacobian @ _step(seen, p, sigma, np.ones(len(p), dtype=bool), scale, 0.0)


def _minimise(
    model: ErrorModel,
    measured: Measurements,
    p: np.ndarray,
    q: np.ndarray,
    free: np.ndarray,
    max_iterations: int,
    priors: bool = False,
) -> Estimate:
    """Levenberg-Marquardt over the parameters `free`, the loops re-closed at every step."""
    tolerance = model.parameters.tolerance
    sigma = tolerance if priors else np.full_like(tolerance, np.inf)
    scale = np.where(np.isfinite(tolerance), tolerance, _FLAT_SCALE)[free]
    here = model.linearise(p, measured, q)
    if here is None:
        raise CalibrationError("the loops can't be closed at the start")
    cost, message = _cost(here, p, sigma), f"not converged after {max_iterations} iterations"
    damping, growth, success, iteration = 0.0, 2.0, False, 0
    while iteration < max_iterations and not success:
        iteration += 1
        step = np.zeros(len(p))
        step[free] = _step(here, p, sigma, free, scale, damping)
        trial = model.linearise(p + step, measured, here.q)
        trial_cost = np.inf if trial is None else _cost(trial, p + step, sigma)
        small = np.max(np.abs(step[free]) / scale) < _STEP
        if trial is not None and trial_cost <= cost * (1 + 1e-12):
            fall = cost - trial_cost
            success = bool(small or (fall < _COST * cost and fall < _LEVEL and damping < _LEAST))
            # Nielsen (1999): the damping follows how well the linear model foretold the fall
            ratio = np.clip(fall / max(_foretold(here, p, sigma, step), 1e-300), 0.0, 1.0)
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3)
            damping, growth = (damping if damping > _LEAST else 0.0), 2.0
            p, here, cost = p + step, trial, trial_cost
        elif small:
            success = True  # the minimum to rounding
        else:
            damping, growth = max(damping, _LEAST) * growth, 2 * growth
        message = "converged" if success else message
    covariance, unseen = _covariance(here, sigma, free, scale)
    return Estimate(p, covariance, unseen, here.jacobian, here.residual, here.q, cost, iteration, success, message)


def _foretold(at: Linearisation, p: np.ndarray, sigma: np.ndarray, step: np.ndarray) -> float:
    """By how much the cost would fall if the model were linear."""
    after = at.residual + at.jacobian @ step
    return _cost(at, p, sigma) - 0.5 * float(after @ after + np.sum(((p + step) / sigma) ** 2))


def _cost(at: Linearisation, p: np.ndarray, sigma: np.ndarray) -> float:
    return 0.5 * float(at.residual @ at.residual + np.sum((p / sigma) ** 2))


def _factor(at: Linearisation, p: np.ndarray, sigma: np.ndarray, free: np.ndarray, scale: np.ndarray):
    """Singular values of the stacked Jacobian in scaled parameters, and the residual in its left singular vectors."""
    prior = np.diag(scale / sigma[free])
    stacked = np.concatenate([at.jacobian[:, free] * scale, prior])
    right = np.concatenate([at.residual, p[free] / sigma[free]])
    triangle = np.asarray(np.linalg.qr(np.column_stack([stacked, right]), mode="r"))
    u, singular, vt = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    return singular, vt, u.T @ triangle[:, -1]


def _step(at, p, sigma, free, scale, damping) -> np.ndarray:
    singular, vt, right = _factor(at, p, sigma, free, scale)
    seen = singular > _NULL * singular[0]
    gain = np.where(seen, singular / (singular**2 + damping + (~seen)), 0.0)
    return -scale * (vt.T @ (gain * right))


def _covariance(
    at: Linearisation, sigma: np.ndarray, free: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    singular, vt, _ = _factor(at, np.zeros(len(sigma)), sigma, free, scale)
    seen = np.zeros(vt.shape[1], dtype=bool)
    seen[: len(singular)] = singular > _NULL * singular[0]
    vectors = np.linalg.svd(vt[: len(singular)][seen[: len(singular)]])[2]  # completed to a basis: the null space too
    half = vt[seen[: len(singular)]] / singular[seen[: len(singular)], None] * scale
    covariance = np.zeros((len(sigma), len(sigma)))
    covariance[np.ix_(free, free)] = half.T @ half
    unseen = np.zeros(len(sigma), dtype=bool)
    unseen[free] = np.sum(vectors[seen.sum() :] ** 2, axis=0) > 1e-8
    return covariance, unseen
