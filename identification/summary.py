"""What is said about an estimate: identifiability, the size of its residuals, outliers."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri

from kincal.identification.channels import CHANNELS, named
from kincal.identification.collinearity import collinearity
from kincal.identification.diagnosis import moved_far
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate
from kincal.identification.identifiability import identifiability
from kincal.identification.identification import Identification, Outlier
from kincal.identification.measurements import Measurements
from kincal.identification.robust_loss import blocks
from kincal.identification.trend import drift_finding
from kincal.urdf.description import Identify
from kincal.urdf.errors import CalibrationError, MovedFarError

_OUTLIER = 1e-5  # the probability that a good pose looks like one
_WIDE = 10.0  # tolerances so many times too wide are worth a word
_FEWEST, _SHARE = 8, 0.2  # by so many parameters, each of such a share that is the data's
_MEDIAN = 0.6745  # of the size of a standard normal deviate
_SURPRISE = 1e-6  # of a chi-square: less likely is a finding


def summarise(
    model: ErrorModel,
    measured: Measurements,
    estimate: Estimate,
    registered: Estimate,
    settings: Identify | None = None,
) -> Identification:
    """An estimate from `measured`, its residuals and outliers; identifiability is that of the `registered` robot.

    Raises CalibrationError where a parameter moved by more than 12 tolerances.
    """
    settings, parameters = settings or Identify(), model.parameters
    measured = measured.scaled(estimate.sigma_factors)
    seen = identifiability(registered.triangle[:, :-1], parameters, measured.rows)
    size, by_channel = _residuals(model, measured, estimate)
    outliers = _outliers(measured, by_channel)
    # a robust loss leaves outliers in the residuals; that they are large says nothing of the others
    counted = np.ones(len(measured), dtype=bool)
    if settings.loss != "gaussian":
        counted = ~np.isin(measured.pose, [o.pose for o in outliers])
    chi_square = float(np.sum(estimate.residual[counted] ** 2))
    freedom = float(counted.sum() * measured.rows_a_pose - estimate.effective)
    variance = np.where(estimate.unseen, np.inf, np.diag(estimate.covariance))
    explained = _verdict(model, measured, estimate, chi_square, freedom)
    return Identification(
        names=parameters.names,
        units=parameters.units,
        nominal=parameters.nominal,
        change=estimate.p,
        tolerance=parameters.tolerance,
        data_share=estimate.resolution,
        std=np.sqrt(variance),
        covariance=estimate.covariance,
        observable_share=seen.observable_share,
        identifiable=seen.identifiable,
        singular_values=seen.singular_values,
        poses=measured.pose,
        residual=estimate.residual,
        rank=seen.rank,
        rank_tolerance=seen.tolerance,
        rank_gap=seen.gap,
        condition_number=seen.condition_number,
        unobservable=seen.unobservable,
        unobservable_basis=seen.basis,
        collinearity=collinearity(registered.triangle, measured.rows, parameters),
        n_poses=len(measured),
        channels=measured.channels,
        sensor_std={c: float(np.sqrt(np.mean(measured.std[c] ** 2))) for c in measured.channels},
        sensor_estimated=dict(estimate.sigma_factors),
        estimator=settings.estimator,
        loss=settings.loss,
        shrinkage=estimate.shrinkage,
        iterations=estimate.iterations,
        message=estimate.message,
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        residual_size=size,
        outliers=outliers,
        findings=(*explained, *_moved(model, estimate, np.sqrt(variance), explained), *_tolerance(model, estimate)),
    )


def left_out(model: ErrorModel, measured: Measurements, p: np.ndarray) -> tuple[Outlier, ...]:
    """Poses that p was not fitted to, with their errors; of one whose loops do not close there is none to tell."""
    robot = model.robot(p)
    closure = robot.close(measured.readings)
    actual, predicted = measured.as_poses(), robot.measured(closure.pose)
    shown = {}
    for channel in named(measured.channels):
        unit, factor = channel.human
        size = factor * np.linalg.norm(channel.error(actual, predicted), axis=1)
        shown[channel.name] = [f"{channel.name} is off by {value:.3g} {unit}" for value in size]
    reasons = [" and ".join(parts) for parts in zip(*shown.values(), strict=True)]
    return tuple(
        Outlier(int(pose), f"left out; {reason if closed else 'the loops do not close there'}")
        for pose, reason, closed in zip(measured.pose, reasons, closure.closed, strict=True)
    )


def _verdict(
    model: ErrorModel, measured: Measurements, estimate: Estimate, chi_square: float, freedom: float
) -> tuple[str, ...]:
    """What the chi-square says of the model and of the sensors' sigmas."""
    if freedom < 1:
        return (
            "the poses give no more readings than the parameters they determine: "
            "residuals can't show whether the model is right",
        )
    larger = float(np.sqrt(chi_square / freedom))
    if chdtrc(freedom, chi_square) < _SURPRISE:
        cause = drift_finding(model, measured, estimate, chi_square, freedom)
        found = f"geometry alone can't explain the measurements: residuals are {larger:.3g} times the sensors' sigmas"
        return (found, cause) if cause else (found,)
    if chdtr(freedom, chi_square) < _SURPRISE:
        return (
            f"residuals are only {larger:.3g} times the sensors' sigmas: the sensors are better than [sensor] states",
        )
    return ()


def _tolerance(model: ErrorModel, estimate: Estimate) -> tuple[str, ...]:
    """A word where what the data determine moved much less than the tolerances allow."""
    tolerance, share = model.parameters.tolerance[:-12], estimate.resolution[:-12]
    determined = share > _SHARE
    if np.sum(determined) < _FEWEST:
        return ()
    sizes = np.abs(estimate.p[:-12] / tolerance)[determined] / np.sqrt(share[determined])
    moved = float(np.median(sizes)) / _MEDIAN
    if moved * _WIDE > 1:
        return ()
    times = float(f"{1 / max(moved, 1e-12):.1g}")
    return (
        f"the identified changes are about {times:g} times smaller than [tolerance]: give the tolerances of your shop",
    )


def _moved(model: ErrorModel, estimate: Estimate, std: np.ndarray, explained: tuple[str, ...]) -> tuple[str, ...]:
    """What to say of parameters that moved far. Raises CalibrationError for too far, with the likely cause if any."""
    try:
        return moved_far(model.parameters, estimate.p, std)
    except MovedFarError as error:
        causes = [finding for finding in explained if finding.startswith("likely cause")]
        if causes:
            raise CalibrationError("; ".join([error.reason, *causes])) from None
        raise


def _residuals(
    model: ErrorModel, measured: Measurements, estimate: Estimate
) -> tuple[dict[str, float | None], dict[str, np.ndarray]]:
    """Root mean squares, and each pose's error by channel [rad or m]."""
    sizes = {
        channel: np.linalg.norm(estimate.residual[:, rows], axis=1) * measured.std[channel]
        for channel, (rows, _) in zip(measured.channels, blocks(measured.channels), strict=True)
    }
    n = len(model.actuators.gain)
    prismatic = model.chain.prismatic[model.chain.actuated]
    actuators = np.full((len(measured), n), np.nan)
    if measured.rows_a_pose >= n:  # the pose determines the actuators: which change of theirs explains the residual?
        by_zero = model.jacobian(estimate.p, measured, estimate.q, model.zeros)
        actuators = -(np.linalg.pinv(by_zero) @ estimate.residual[..., None])[..., 0]
    size = {c.field: _rms(sizes.get(c.name), c.human[1]) for c in CHANNELS}
    size["prismatic_mm"] = _rms(actuators[:, prismatic], 1e3)
    size["revolute_deg"] = _rms(actuators[:, ~prismatic], 180 / np.pi)
    return size, sizes


def _rms(values: np.ndarray | None, factor: float) -> float | None:
    if values is None or not values.size or np.isnan(values).any():
        return None
    return factor * float(np.sqrt(np.mean(values**2)))


def _outliers(measured: Measurements, by_channel: dict[str, np.ndarray]) -> tuple[Outlier, ...]:
    """Poses whose error is too large for a Gaussian of the width that the median tells."""
    outliers = []
    for channel in named(by_channel):
        size, (unit, factor) = by_channel[channel.name], channel.human
        median = float(np.median(size))
        limit = np.sqrt(chdtri(channel.rows, _OUTLIER) / chdtri(channel.rows, 0.5))  # in medians
        for k in np.flatnonzero(size > limit * median):
            reason = f"{channel.name} is off by {factor * size[k]:.3g} {unit}, {size[k] / median:.1f} times the median"
            outliers.append(Outlier(int(measured.pose[k]), reason))
    return tuple(sorted(outliers, key=lambda o: o.pose))
