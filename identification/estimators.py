"""Five estimators of all parameters behind one function and one result, with robust loss and variance components.

MAP, with the manufacturing tolerances as priors, is the default: well posed for any number of poses that can register W
and T. Least squares and truncated SVD move the geometry on the identifiable subspace alone; ridge and Liu shrink it in
columns of unit length. Which shrinkage, `shrinkage.py` chooses on the model linearised at the MAP estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from kincal.identification import registration
from kincal.identification.error_model import ErrorModel, require_closed
from kincal.identification.least_squares import Problem, Solution, minimise
from kincal.identification.measurements import Measurements
from kincal.identification.robust_loss import Loss, blocks
from kincal.identification.shrinkage import (
    N_FRAMES,
    Linear,
    Standardised,
    choose_by_folds,
    choose_by_gcv,
    columns_scale,
    identifiable,
    standardise,
    uncertainty,
)
from kincal.urdf.description import Identify
from kincal.urdf.errors import CalibrationError, InputError, NotConvergedError

_FLAT_SCALE = 1e-2  # a natural size for W and T in the scaled Jacobian [m, rad]; decides nothing but rounding
_OTHERS = 30  # iterations of other starts, once one has converged
_FOLDS = 10
_ROUNDS = 20  # of variance components
_SETTLED = 2e-3  # of a sigma, relative
_REDUNDANT = 5.0  # a sensor's rows less the parameters they determine: with fewer its sigma can't be estimated


@dataclass(frozen=True)
class Estimate:
    """The words of scipy.optimize, and what a calibration engineer asks for besides."""

    p: np.ndarray  # (n_parameters,) changes from nominal
    covariance: np.ndarray  # (n_parameters, n_parameters); directions that nothing sees are left out of it
    unseen: np.ndarray  # (n_parameters,) bool: the parameter takes part in such a direction: its sigma is infinite
    resolution: np.ndarray  # (n_parameters,) share of each change that is the data's, not the prior's
    effective: float  # number of parameters that the data determine
    leverage: np.ndarray  # (n_parameters, n_parameters) L: J L J' is the hat matrix, its trace is `effective`
    residual: np.ndarray  # (n, rows a pose) whitened
    triangle: np.ndarray  # of the whitened identification Jacobian and the residual: `Linearisation.triangle`
    q: np.ndarray  # (n, n_joints) the closed configurations of the measured poses
    cost: float  # of the loss and the priors; half the sum of squares where the loss is gaussian
    shrinkage: float  # as chosen: the scale of the priors, k, d, or the number of directions kept
    sigma_factors: Mapping[str, float]  # channels whose sigma was estimated: times what was assumed
    iterations: int
    success: bool
    message: str


def register(model: ErrorModel, measured: Measurements, max_iterations: int = 300) -> Estimate:
    """Fit W and T alone to the nominal robot: what `nominal` means.

    Raises InputError for too few poses or loops that can't be closed, CalibrationError where no start converges.
    """
    n = len(model.parameters)
    best = registration_of(model, measured, max_iterations)
    _require(best, "registration of W and T")
    data = standardise(_linear(best, measured), np.zeros(n - N_FRAMES))
    return _result(best, best.at.triangle, data, np.zeros(len(data.s)), np.zeros(n), 0.0)


def registration_of(model: ErrorModel, measured: Measurements, max_iterations: int) -> Solution:
    """The best of all starts, converged or not. Raises InputError as `register` does."""
    n = len(model.parameters)
    closure = require_closed(model.robot(np.zeros(n)).close(measured.readings), measured)
    problem = Problem(model, measured, _FLAT_SCALE * np.eye(n)[:, -N_FRAMES:], np.full(n, np.inf))
    solutions: list[Solution] = []
    for w, t in registration.starts(closure.pose, measured):  # the likeliest first
        steps = min(max_iterations, _OTHERS) if any(s.success for s in solutions) else max_iterations
        solutions.append(minimise(problem, model.with_frames(np.zeros(n), w, t), closure.q, steps))
    converged = [s for s in solutions if s.success]
    return min(converged or solutions, key=lambda s: s.cost)


def estimate_parameters(
    model: ErrorModel,
    measured: Measurements,
    settings: Identify | None = None,
    registered: Estimate | None = None,
) -> Estimate:
    """All parameters, by the estimator and the loss of `settings`; W and T have flat priors and start registered.

    registered: what `register` found on the same measurements, where that is known. The sigma of a sensor that nobody
    gave (`measured.assumed`) is estimated from its residuals.
    Raises InputError as `register` does and for a sigma that the data can't tell, CalibrationError where the iteration
    does not converge or the choice of the priors' scale ends at a bound.
    """
    settings = settings or Identify()
    start = registered or register(model, measured, settings.max_iterations)
    factors = dict.fromkeys(measured.assumed, 1.0)
    for _ in range(_ROUNDS):
        poses = measured.scaled(factors)
        estimate = _estimate(model, poses, settings, start)
        change = _variance_components(model, poses, measured.assumed, estimate, settings)
        factors = {c: factors[c] * f for c, f in change.items()}
        if all(abs(np.log(f)) < _SETTLED for f in change.values()):
            return replace(estimate, sigma_factors=factors)
    raise NotConvergedError(
        f"the sigmas of {', '.join(factors)} did not settle in {_ROUNDS} rounds: give them in [sensor]"
    )


def foreseen(model: ErrorModel, measured: Measurements) -> Estimate:
    """What MAP will know from such measurements of the robot as drawn, before anybody measures: p = 0.

    measured: noise-free, of the robot as drawn with W = T = 1. Only what does not depend on readings means anything.
    """
    p, tolerance = np.zeros(len(model.parameters)), model.parameters.tolerance
    at = model.linearise(p, measured)
    assert at is not None  # planned poses close their loops
    data = standardise(_about(at.triangle, p, measured.rows), tolerance[:-N_FRAMES])
    return _result(
        Solution(p, at, 0.0, 0, True, "foreseen"), at.triangle, data, data.filter("map", 1.0), tolerance, 1.0
    )


def _estimate(model: ErrorModel, measured: Measurements, settings: Identify, start: Estimate) -> Estimate:
    estimator, tolerance = settings.estimator, model.parameters.tolerance
    given = settings.shrinkage if isinstance(settings.shrinkage, float | int) else None
    natural = np.where(model.parameters.flat, _FLAT_SCALE, tolerance)
    prior = tolerance * (given if estimator == "map" and given is not None else 1.0)
    problem = Problem(model, measured, np.diag(natural), prior)
    best = _robust(problem, start.p, start.q, settings)
    iterations, chosen = 0, 1.0 if given is None else given
    scale = columns_scale(start.triangle, estimator, tolerance)
    within = None if estimator == "map" else identifiable(_about(start.triangle, start.p, measured.rows), scale)
    if estimator == "map":
        if isinstance(settings.shrinkage, str):
            iterations += best.iterations
            chosen = _choose(model, measured, best, settings, scale, within)
            best = _robust(replace(problem, sigma=tolerance * chosen), best.p, best.at.q, settings)
    else:
        iterations += best.iterations
        if given is None and estimator != "least_squares":
            chosen = _choose(model, measured, best, settings, scale, within)
        data = standardise(_linear(best, measured), scale, within)
        best = _shrunk(replace(problem, sigma=np.full(len(prior), np.inf)), data, start, best, settings, chosen)
    iterations += best.iterations
    triangle, loss = best.at.triangle, Loss(settings.loss)
    if loss.kind != "gaussian":
        weighed = model.linearise(best.p, measured, best.at.q, lambda r: loss.information(r, measured.channels))
        assert weighed is not None  # these loops have just been closed
        triangle = weighed.triangle
    data = standardise(Linear(triangle, measured.rows), scale, within)
    believed = tolerance * chosen if estimator == "map" else tolerance
    estimate = _result(best, triangle, data, data.filter(estimator, chosen), believed, chosen)
    return replace(estimate, iterations=iterations)


def _shrunk(
    problem: Problem, data: Standardised, start: Estimate, best: Solution, settings: Identify, chosen: float
) -> Solution:
    """The estimate by ridge, truncated SVD, Liu or least squares, from the registered robot."""
    n = len(start.p)
    frames = _FLAT_SCALE * np.eye(n)[:, -N_FRAMES:]
    if settings.estimator == "ridge":
        sigma = np.concatenate([data.scale / np.sqrt(max(chosen, 1e-300)), np.full(N_FRAMES, np.inf)])
        sigma[:-N_FRAMES][data.scale == 0] = np.inf
        problem = replace(problem, sigma=sigma)
    kept = data.filter("truncated_svd", chosen if settings.estimator == "truncated_svd" else len(data.s)) > 0
    directions = np.zeros((n, int(kept.sum())))
    directions[:-N_FRAMES] = (data.vt[kept] * data.scale).T
    directions /= np.linalg.norm(directions / problem.model.parameters.tolerance[:, None], axis=0)  # a natural size
    solution = _robust(replace(problem, basis=np.concatenate([directions, frames], axis=1)), start.p, start.q, settings)
    if settings.estimator != "liu":
        return solution
    along = np.linalg.lstsq(directions, solution.p, rcond=None)[0]
    p = solution.p.copy()
    p[:-N_FRAMES] = (directions @ (data.filter("liu", chosen)[kept] * along))[:-N_FRAMES]
    return _robust(replace(problem, basis=frames), p, solution.at.q, settings)


def _robust(problem: Problem, p: np.ndarray, q: np.ndarray, settings: Identify) -> Solution:
    """The minimum of the loss asked for, by way of easier ones: least squares, then Huber's, then Cauchy's."""
    losses = ("gaussian", "huber", "cauchy")
    iterations = 0
    for loss in losses[: losses.index(settings.loss) + 1]:
        solution = minimise(replace(problem, loss=Loss(loss)), p, q, settings.max_iterations)
        iterations += solution.iterations
        if loss == settings.loss:
            _require(solution, "identification")
        p, q = solution.p, solution.at.q
    return replace(solution, iterations=iterations)


def _choose(
    model: ErrorModel,
    measured: Measurements,
    at: Solution,
    settings: Identify,
    scale: np.ndarray,
    within: np.ndarray | None,
) -> float:
    estimator = settings.estimator
    data = standardise(_linear(at, measured), scale, within)
    if settings.shrinkage != "kfold":
        chosen = choose_by_gcv(data, estimator)
    else:
        order = np.random.default_rng(0).permutation(len(measured))
        loss, parts = Loss(settings.loss), []
        for rows in np.array_split(order, min(_FOLDS, len(measured))):
            part = model.linearise(at.p, measured[rows], at.at.q[rows], lambda r: loss.weights(r, measured.channels))
            assert part is not None  # these loops have just been closed
            parts.append(_about(part.triangle, at.p, len(rows) * measured.rows_a_pose))
        chosen = choose_by_folds(parts, scale, within, estimator)
    bounds = data.candidates(estimator)
    if estimator == "map" and chosen in (bounds[0], bounds[-1]):
        raise CalibrationError(
            f"the scale of the priors ended at its bound, {chosen:g}: the tolerances do not fit these data; "
            "correct [tolerance], or give identify.shrinkage"
        )
    return chosen


def _variance_components(
    model: ErrorModel, measured: Measurements, assumed: tuple[str, ...], estimate: Estimate, settings: Identify
) -> dict[str, float]:
    """What each assumed sigma is to be multiplied by: residuals against rows less what was fitted."""
    if not assumed:
        return {}
    loss, factors = Loss(settings.loss), {}
    information = loss.information(estimate.residual, measured.channels)
    fitted = np.zeros(measured.rows_a_pose)
    for rows in np.array_split(np.arange(len(measured)), max(1, len(measured) // 1000)):
        jacobian = model.jacobian(estimate.p, measured[rows], estimate.q[rows])
        fitted += np.sum(information[rows] * np.sum((jacobian @ estimate.leverage) * jacobian, axis=2), axis=0)
    weights = loss.weights(estimate.residual, measured.channels)
    for channel, (rows, d) in zip(measured.channels, blocks(measured.channels), strict=True):
        if channel not in assumed:
            continue
        free = d * len(measured) - float(fitted[rows].sum())
        if free < _REDUNDANT:
            raise InputError(
                f"sensor: sigma of {channel} is not given, and {len(measured)} poses can't determine it "
                f"({d * len(measured)} readings, all but {max(free, 0):.1f} of them fitted); give it in [sensor]"
            )
        size = float(np.sum(weights[:, rows] * estimate.residual[:, rows] ** 2))  # weighted, its mean is the same
        factors[channel] = float(np.sqrt(max(size, 1e-12) / free))
    return factors


def _require(solution: Solution, task: str) -> None:
    if not solution.success:
        raise NotConvergedError(f"{task} did not converge: {solution.message}")


def _about(triangle: np.ndarray, p: np.ndarray, rows: int) -> Linear:
    """The linear model of the data, from the triangle of (J, r) at p."""
    return Linear(np.column_stack([triangle[:, :-1], triangle[:, :-1] @ p - triangle[:, -1]]), rows)


def _linear(at: Solution, measured: Measurements) -> Linear:
    return _about(at.at.triangle, at.p, measured.rows)


def _result(
    at: Solution, triangle: np.ndarray, data: Standardised, f: np.ndarray, tolerance: np.ndarray, shrinkage: float
) -> Estimate:
    certain = uncertainty(data, f, tolerance)
    return Estimate(
        p=at.p,
        covariance=certain.covariance,
        unseen=certain.unseen,
        resolution=certain.resolution,
        effective=certain.effective,
        leverage=certain.leverage,
        residual=at.at.residual,
        triangle=triangle,
        q=at.at.q,
        cost=at.cost,
        shrinkage=shrinkage,
        sigma_factors={},
        iterations=at.iterations,
        success=at.success,
        message=at.message,
    )


def left_out(
    model: ErrorModel, p: np.ndarray, jacobian: np.ndarray, residual: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Whitened residuals (n, rows a pose) of an identification without the poses `rows`: one linear step from p.

    jacobian: (n, rows a pose, n_parameters) at p; residual: (n, rows a pose). The priors are the tolerances.
    """
    kept = np.setdiff1d(np.arange(len(residual)), rows)
    steps = [_linear_step(model, p, jacobian[some], residual[some]) for some in (slice(None), kept)]
    return residual + jacobian @ (steps[1] - steps[0])


def _linear_step(model: ErrorModel, p: np.ndarray, jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    tolerance = model.parameters.tolerance
    stacked = np.column_stack([jacobian.reshape(-1, len(p)), residual.ravel()])
    triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    data = standardise(_about(triangle, p, residual.size), tolerance[:-N_FRAMES])
    geometry = data.geometry(data.filter("map", 1.0))
    frames = data.frames @ (triangle[:, :-1] @ p - triangle[:, -1]) - data.coupling @ geometry
    null = data.frames_null
    frames = frames + null @ (null.T @ p[-N_FRAMES:])  # what nothing sees stays where it is
    return np.concatenate([geometry, frames]) - p
