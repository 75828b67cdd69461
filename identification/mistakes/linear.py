"""Measurements about the registered robot as drawn, to first order in all parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.registered import Registered, registered
from kincal.urdf.rigid_motion import Motion

_FLAT = 0.1  # sigma of W's and T's steps beside the registered ones [m, rad]
FRAMES = 12
_ROUNDS, _SETTLED = 30, 0.01


@dataclass(frozen=True)
class LinearRobot:
    """Whitened residuals and their derivatives, parameters in units of their prior's sigma.

    Tolerances are the priors, so the robot is one near its drawing; W and T are free.
    """

    at: Registered
    residual: np.ndarray  # (n, rows a pose)
    jacobian: np.ndarray  # (n, rows a pose, n_parameters)
    channels: tuple[str, ...]

    @classmethod
    def of(cls, model: ErrorModel, measured: Measurements, at: Registered | None = None) -> LinearRobot:
        """Raises InputError where the loops do not close at the readings."""
        at = registered(model, measured) if at is None else at
        p = model.with_frames(np.zeros(len(model.parameters)), at.robot.instrument, at.robot.target)
        sigma = _sigma(model)
        # where residuals are large, as a mistake makes them, their own derivatives are wild: those of small ones count
        pose = at.robot.measured(at.tool)
        predicted = measured.replaced(**{c.name: c.of(pose) for c in named(measured.channels)})
        jacobian = model.jacobian(p, predicted, at.q) * sigma
        return cls(at, pose_residual(pose, measured), jacobian, measured.channels)

    @cached_property
    def misfit(self) -> float:
        """r' (1 + J J')^-1 r a degree of freedom: 1 for a robot within its tolerances, measured without a mistake.

        Errors that geometry can't explain, and the second order, make it larger.
        """
        _, step = self.solved()
        return float(np.sum(self.after(step) ** 2) + np.sum(step[:-FRAMES] ** 2)) / self.freedom

    @cached_property
    def predicted(self) -> Motion:
        """(n) poses that the registered robot shows at the readings."""
        return self.at.robot.measured(self.at.tool)

    def with_sigmas(self, factor: float) -> LinearRobot:
        """The same, all sigmas so many times larger."""
        return replace(self, residual=self.residual / factor, jacobian=self.jacobian / factor)

    def sigmas_that_fit(self) -> float:
        """By how much all sigmas are to be multiplied for residuals, after the fit, that are as large as they."""
        factor = 1.0
        for _ in range(_ROUNDS):
            scaled = self.with_sigmas(factor)
            change = float(np.sqrt(np.sum(scaled.after(scaled.solved()[1]) ** 2) / self.freedom))
            factor *= change
            if abs(change - 1) < _SETTLED:
                break
        return factor

    def misfit_nearby(self, model: ErrorModel, measured: Measurements) -> float:
        """The misfit by derivatives at the minimum that `misfit` supposes: of a robot far from its drawing, smaller.

        `misfit` itself where the loops do not close there.
        """
        _, step = self.solved()
        drawn = model.with_frames(np.zeros(len(model.parameters)), self.at.robot.instrument, self.at.robot.target)
        p = drawn + step * _sigma(model)
        robot = model.robot(p)
        closure = robot.close(measured.readings)
        if not closure.closed.all():
            return self.misfit
        residual = pose_residual(robot.measured(closure.pose), measured).ravel()
        rows = (model.jacobian(p, measured, closure.q) * _sigma(model)).reshape(len(residual), -1)
        rows = np.concatenate([rows, np.eye(len(step))])
        right = np.concatenate([residual, step * (np.arange(len(step)) < len(step) - FRAMES)])
        left = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
        return min(float(left @ left) / self.freedom, self.misfit)

    @property
    def freedom(self) -> int:
        """Rows less those that W and T take."""
        return max(self.residual.size - FRAMES, 1)

    def solved(self, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The information's Cholesky factor, and the step to the minimum; weights: (n,) of the poses, default 1."""
        rows = self.jacobian.reshape(-1, self.jacobian.shape[-1])
        weighted = rows if weights is None else np.repeat(weights, self.residual.shape[1])[:, None] * rows
        information = weighted.T @ rows
        information.flat[:: len(information) + 1] += 1.0
        factor = scipy.linalg.cholesky(information, lower=True)
        return factor, -scipy.linalg.cho_solve((factor, True), weighted.T @ self.residual.ravel())

    def after(self, step: np.ndarray) -> np.ndarray:
        """(n, rows a pose) residuals after a step."""
        return self.residual + self.jacobian @ step

    def lengths(self, step: np.ndarray) -> dict[str, np.ndarray]:
        """{channel: (n,) length of each pose's whitened residual after a step}."""
        left, first, lengths = self.after(step), 0, {}
        for channel in named(self.channels):
            lengths[channel.name] = np.linalg.norm(left[:, first : first + channel.rows], axis=1)
            first += channel.rows
        return lengths


def _sigma(model: ErrorModel) -> np.ndarray:
    """(n_parameters,)"""
    return np.where(model.parameters.flat, _FLAT, model.parameters.tolerance)
