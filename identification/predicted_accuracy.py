"""How accurate an identified robot will be, before its poses are measured.

The covariance after a plan, (I + sum J'J)^-1, propagated to fresh poses of the workspace. It counts what instruments
and tolerances leave unknown of the geometry; what geometry can't explain comes on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from kincal.identification.channels import scored
from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import Sites, prior_sigma

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)


_Sizes = tuple[float | None, float | None, float | None]


@dataclass(frozen=True)
class PredictedAccuracy:
    """Expected errors |e| over fresh poses: mean, root mean square, and the worst pose's. None: not measured."""

    mean_deg: float | None
    rms_deg: float | None
    max_deg: float | None
    mean_mm: float | None
    rms_mm: float | None
    max_mm: float | None


@dataclass(frozen=True)
class Probe:
    """Fresh poses, and how their predicted pose follows the parameters, in units of their prior's sigma."""

    turned: np.ndarray | None  # (m, k, n_parameters) [rad]
    moved: np.ndarray | None  # (m, k, n_parameters) [m]

    @staticmethod
    def of(model: ErrorModel, sites: Sites, channels: tuple[str, ...]) -> Probe:
        """At fresh poses `sites` of the robot as drawn: of what `channels` measure, as accuracy is scored.

        With tilt but no heading the error is that of the vertical; the rotation about it is not looked at.
        """
        p = np.zeros(len(model.parameters))
        jacobian = model.pose_jacobian(p, sites.readings, sites.q) * prior_sigma(model.parameters)
        robot = model.robot(p)
        rotation = robot.measured(robot.close(sites.readings, sites.q).pose).rotation
        shown = {unit: channel.change(jacobian, rotation) for unit, channel in scored(channels).items()}
        return Probe(shown.get("rad"), shown.get("m"))

    def accuracy(self, jacobian: np.ndarray) -> PredictedAccuracy:
        """After a plan with blocks `jacobian` (n, rows a pose, n_parameters), as `expected.information` gives them."""
        n = jacobian.shape[-1]
        factor = np.asarray(np.linalg.qr(np.concatenate([np.eye(n), jacobian.reshape(-1, n)]), mode="r"))
        return PredictedAccuracy(*_sizes(self.turned, factor, 180 / np.pi), *_sizes(self.moved, factor, 1e3))


def _sizes(rates: np.ndarray | None, factor: np.ndarray, unit: float) -> _Sizes:
    """Of |e| over poses, e = rates dp with dp of the covariance (factor' factor)^-1: mean, rms, and largest E|e|."""
    if rates is None:
        return None, None, None
    half = scipy.linalg.solve_triangular(factor.T, rates.reshape(-1, rates.shape[-1]).T, lower=True).T
    half = half.reshape(rates.shape)
    covariance = half @ half.swapaxes(1, 2)
    length = mean_length(covariance)
    rms = np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))
    return unit * float(np.mean(length)), unit * float(rms), unit * float(np.max(length))


def mean_length(covariance: np.ndarray) -> np.ndarray:
    """(n,) E|e| of Gaussians e with covariances C: (n, k, k).

    E sqrt(x) = pi^(-1/2) * integral of (1 - E exp(-s^2 x)) / s^2 ds over s > 0, where for x = |e|^2
    E exp(-s^2 x) = det(I + 2 s^2 C)^(-1/2).
    """
    variances = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    largest = np.maximum(variances[:, -1], 1e-300)
    angle = (_NODES + 1) * np.pi / 4  # s = tan(angle) / sqrt(2 * largest)
    shares = variances / largest[:, None]
    transform = np.prod(1 + np.tan(angle) ** 2 * shares[:, :, None], axis=1) ** -0.5
    integral = np.sum(_WEIGHTS * (1 - transform) / np.sin(angle) ** 2, axis=1) * np.pi / 4
    return np.sqrt(2 * largest / np.pi) * integral
