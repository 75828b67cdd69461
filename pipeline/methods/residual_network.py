"""How the residual network meets the robot: its task, its refinement together with the geometry, its predictions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import prior_sigma
from kincal.identification.measurements import Measurements
from kincal.identification.poses import equal_parts
from kincal.learning.correction import Correction
from kincal.learning.residual import Task, fit_correction, learning_curve, refit
from kincal.learning.units import Inherited
from kincal.pipeline.learned import Corrected
from kincal.pipeline.results import Fit
from kincal.urdf.description import Correct
from kincal.urdf.kinematics import Closure

_FOLDS, _FEW = 10, 20  # of cross-validation; up to so many poses, each is left out alone
_BELOW = 0.1  # of the sigma that geometry leaves
_ROUNDS = 2  # linearisations about the refined geometry; each gains four digits


@dataclass(frozen=True)
class _State:
    """A robot's geometry and its correction, if any."""

    p: np.ndarray
    correction: Correction | None

    def close(self, model: ErrorModel, readings: np.ndarray) -> Closure:
        return model.robot(self.p).close(readings, shift=self.delta(readings))

    def delta(self, readings: np.ndarray) -> np.ndarray:
        return np.zeros_like(readings) if self.correction is None else self.correction(readings)


def corrected(
    model: ErrorModel,
    measured: Measurements,
    fit: Fit,
    inherited: Inherited,
    settings: Correct,
    seed: int,
    sigmas_known: bool = True,
) -> Corrected:
    """What the poses that `fit` has seen say that geometry can't explain, and the geometry refined beside it.

    sigmas_known: of the instruments; else `measured` has those of what geometry leaves.
    """
    training = np.setdiff1d(np.arange(len(measured)), fit.test)
    poses = measured[training]
    if not sigmas_known:  # what geometry leaves is no measure of the instruments: the noise is found anew, from below
        poses = poses.scaled(dict.fromkeys(poses.channels, _BELOW))
    sigma = prior_sigma(model.parameters)
    state = _State(fit.identified, None)
    task = _task(model, poses, state, sigmas_known)
    correction, z = fit_correction(
        task,
        equal_parts(len(poses), _FOLDS if len(poses) > _FEW else len(poses), seed),
        inherited,
        own=settings.own_units,
        shared=settings.shared_units,
        seed=seed,
    )
    # only of the fit that ships does anybody ask what more poses would bring
    curve = learning_curve(task, correction, seed) if not len(fit.test) else np.zeros((0, 3))
    if correction.shrinkage == 0.0:
        return Corrected(fit.identified, correction, curve)
    for _ in range(_ROUNDS):
        state = _State(sigma * z, correction)
        if not state.close(model, poses.readings).closed.all():
            break
        correction, z = refit(correction, _task(model, poses, state, sigmas_known))
    return Corrected(sigma * z, correction, curve)


def _task(model: ErrorModel, poses: Measurements, state: _State, sigmas_known: bool) -> Task:
    """Linearised at `state`, told of the robot as drawn and uncorrected."""
    q = state.close(model, poses.readings).require(lambda row: f"correct: pose {poses.pose[row]}").q
    error = model.residual(model.robot(state.p), q, poses)
    jacobian = model.jacobian(state.p, poses, q)
    by_output = jacobian[:, :, model.zeros]
    drawn = error - jacobian @ state.p - (by_output @ state.delta(poses.readings)[..., None])[..., 0]
    return Task(poses.readings, drawn, jacobian * prior_sigma(model.parameters), by_output, sigmas_known)
