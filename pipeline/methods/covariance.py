"""How sure a predicted pose is: covariance of its orientation and position, and the region that holds it with 95 %.

Of the robot itself, without the noise of an instrument that looks at it. Calibrated by cross-validation.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import prior_sigma
from kincal.learning.correction import HELD
from kincal.pipeline.learned import Corrected
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.pipeline.results import Fit


def pose_covariance(
    model: ErrorModel, fit: Fit, corrected: Corrected, method: ModelMethod | HybridMethod, readings: np.ndarray
) -> np.ndarray:
    """(n, 6, 6): of rotation vectors in the target's frame [rad] and of positions [m]; of `geometric` or `hybrid`.

    Between the two it goes as the prediction does.
    """
    correction = corrected.correction
    if isinstance(method, HybridMethod):
        closure, alone = method.close(readings), method.geometric
        share = np.where(closure.closed, correction.share(readings), 0.0)
        geometric = _alone(model, fit, corrected, alone, readings)
        by_model, by_zero = _derivatives(model, corrected.refined, readings, closure.q)
        units = by_zero @ correction.by_weights(readings)
        refined = correction.refined.of(by_model, by_zero * correction.scale, units)
        part = share[:, None, None]
        return np.where(part > 0, part * refined + (1 - part) * geometric, geometric)
    return _alone(model, fit, corrected, method, readings)


def _alone(model: ErrorModel, fit: Fit, corrected: Corrected, method: ModelMethod, readings: np.ndarray) -> np.ndarray:
    by_model, by_zero = _derivatives(model, fit.identified, readings, method.close(readings).q)
    return corrected.correction.alone.of(by_model, by_zero * corrected.correction.scale, None)


def _derivatives(model: ErrorModel, p: np.ndarray, readings: np.ndarray, q: np.ndarray):
    jacobian = model.pose_jacobian(p, readings, q)
    return jacobian * prior_sigma(model.parameters), jacobian[:, :, model.zeros]


def sigma(covariance: np.ndarray, axes: int = 3) -> np.ndarray:
    """(n,) one sigma along an axis, root mean square over `axes` of them."""
    return np.sqrt(np.trace(covariance, axis1=1, axis2=2) / axes)


def radius(covariance: np.ndarray, held: float = HELD) -> np.ndarray:
    """(n,) within which the true value lies with probability `held`; covariance: (n, k, k).

    The distance's square is a sum of weighted chi-squares; a scaled chi-square of the same mean and variance stands for
    it (Satterthwaite 1946), to one or two per cent at 95 %.
    """
    mean = np.trace(covariance, axis1=1, axis2=2)
    square = np.maximum(np.sum(covariance**2, axis=(1, 2)), 1e-300)
    freedom = np.maximum(mean**2 / square, 1e-9)
    return np.sqrt(np.maximum(mean, 0.0) / freedom * 2 * gammaincinv(freedom / 2, held))
