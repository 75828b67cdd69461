"""What is said about an estimate: identifiability, the size of its residuals, outliers."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from identification.error_model import ErrorModel
from identification.estimators import Estimate
from identification.identifiability import identifiability
from identification.identification import Identification, Outlier, ResidualSize
from identification.measurements import Measurements

_OUTLIER = 1e-5  # the probability that a good pose looks like one
_ROWS = {"orientation": 3, "tilt": 2, "yaw": 1, "position": 3}


def summarise(model: ErrorModel, measured: Measurements, estimate: Estimate, registered: Estimate) -> Identification:
    """An estimate from `measured`, its residuals and outliers; identifiability is that of the `registered` robot."""
    parameters = model.parameters
    seen = identifiability(registered.jacobian, parameters)
    residual = estimate.residual.reshape(len(measured), -1)
    size, by_channel = _residuals(model, measured, estimate)
    variance = np.where(estimate.unseen, np.inf, np.diag(estimate.covariance))
    return Identification(
        names=parameters.names,
        units=parameters.units,
        nominal=parameters.nominal,
        change=estimate.p,
        tolerance=parameters.tolerance,
        std=np.sqrt(variance),
        covariance=estimate.covariance,
        observable_share=seen.observable_share,
        identifiable=seen.identifiable,
        singular_values=seen.singular_values,
        poses=measured.pose,
        residual=residual,
        rank=seen.rank,
        rank_tolerance=seen.tolerance,
        condition_number=seen.condition_number,
        unobservable=seen.unobservable,
        n_poses=len(measured),
        channels=measured.channels,
        iterations=estimate.iterations,
        message=estimate.message,
        chi_square=float(estimate.residual @ estimate.residual),
        degrees_of_freedom=float(
            len(estimate.residual) - np.sum(estimate.jacobian @ estimate.covariance * estimate.jacobian)
        ),
        residual_size=size,
        outliers=_outliers(measured, by_channel),
    )


def _residuals(
    model: ErrorModel, measured: Measurements, estimate: Estimate
) -> tuple[ResidualSize, dict[str, np.ndarray]]:
    """Root mean squares, and each pose's error by channel [rad or m]."""
    whitened = estimate.residual.reshape(len(measured), -1)
    sizes, row = {}, 0
    for channel, rows in _ROWS.items():
        if channel in measured.channels:
            sigma = getattr(measured, f"{channel}_std")
            sizes[channel] = np.linalg.norm(whitened[:, row : row + rows], axis=1) * sigma
            row += rows
    n = len(model.actuators.gain)
    prismatic = model.chain.prismatic[model.chain.actuated]
    actuators = np.full((len(measured), n), np.nan)
    if row >= n:  # the pose determines the actuators: which change of theirs explains the residual?
        by_zero = estimate.jacobian[:, -12 - 2 * n : -12 - n].reshape(len(measured), -1, n)
        actuators = -(np.linalg.pinv(by_zero) @ whitened[..., None])[..., 0]
    size = ResidualSize(
        orientation_deg=_rms(sizes.get("orientation"), 180 / np.pi),
        position_mm=_rms(sizes.get("position"), 1e3),
        tilt_deg=_rms(sizes.get("tilt"), 180 / np.pi),
        yaw_deg=_rms(sizes.get("yaw"), 180 / np.pi),
        prismatic_mm=_rms(actuators[:, prismatic], 1e3),
        revolute_deg=_rms(actuators[:, ~prismatic], 180 / np.pi),
    )
    return size, sizes


def _rms(values: np.ndarray | None, factor: float) -> float | None:
    if values is None or not values.size or np.isnan(values).any():
        return None
    return factor * float(np.sqrt(np.mean(values**2)))


def _outliers(measured: Measurements, by_channel: dict[str, np.ndarray]) -> tuple[Outlier, ...]:
    """Poses whose error is too large for a Gaussian of the width that the median tells."""
    found = []
    for channel, size in by_channel.items():
        factor, unit = (1e3, "mm") if channel == "position" else (180 / np.pi, "deg")
        median, dimensions = float(np.median(size)), _ROWS[channel]
        limit = np.sqrt(chdtri(dimensions, _OUTLIER) / chdtri(dimensions, 0.5))  # in medians
        for k in np.flatnonzero(size > limit * median):
            reason = f"{channel} is off by {factor * size[k]:.3g} {unit}, {size[k] / median:.1f} times the median"
            found.append(Outlier(int(measured.pose[k]), reason))
    return tuple(sorted(found, key=lambda o: o.pose))
