"""The robot as built."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from kincal.pipeline.results import Fit, Identified, Measured
from kincal.pipeline.stages.robot_data import Poses
from kincal.urdf.description import Identify

if TYPE_CHECKING:
    import numpy as np

    from kincal.identification.error_model import ErrorModel
    from kincal.identification.identification import Identification
    from kincal.identification.measurements import Measurements


def identify_stage(poses: Poses, measured: Measured, identify: Identify) -> Identified:
    """All geometric parameters from the measured poses; and from parts of them, to be scored on the rest."""
    import numpy as np

    from kincal.identification.poses import folds, held_out

    built = as_built(poses, identify)
    errors, split, seed = poses.errors, poses.split, poses.seed
    measurements = built.measurements.scaled(built.identification.sensor_estimated)
    parts = () if measured.truth is not None else folds(len(measurements), split, seed)
    test = held_out(len(measurements), split, seed)
    return Identified(
        shipped=built.identification,
        registered=built.registered,
        held_out=_fit(errors, measurements, test, identify),
        folds=tuple(_fit(errors, measurements, part, identify) for part in parts),
        left_out=tuple(np.setdiff1d(poses.measurements.pose, measurements.pose).tolist()),
    )


@dataclass(frozen=True)
class AsBuilt:
    """The robot, and the poses that it was identified from."""

    identification: Identification
    registered: np.ndarray  # (n_parameters,) W and T alone
    measurements: Measurements  # without those that do not fit the others


def as_built(poses: Poses, settings: Identify) -> AsBuilt:
    """The robot from all of these poses that fit the others. Raises InputError and CalibrationError."""
    from dataclasses import replace

    from kincal.identification.coverage import coverage_finding
    from kincal.identification.diagnosis import cause_of_misfit, explained, screened
    from kincal.identification.estimators import estimate_parameters, register
    from kincal.identification.rounding import rounding_finding
    from kincal.identification.summary import left_out, summarise
    from kincal.urdf.errors import CalibrationError

    errors = poses.errors
    screening = screened(errors, poses.measurements, settings.reject_outliers)
    measurements = poses.measurements[screening.kept] if screening.finding else poses.measurements
    try:
        registered = register(errors, measurements, settings.max_iterations)
        whole = estimate_parameters(errors, measurements, settings, registered)
        made = summarise(errors, measurements, whole, registered, settings)
    except CalibrationError as error:
        raise explained(errors, measurements, error) from None
    uncovered = coverage_finding(errors, poses.model.mechanism.workspace, measurements, whole, poses.seed)
    cause = cause_of_misfit(errors, measurements, whole.p, screening.misfit)
    findings = [text for text in made.findings if not (cause and text.startswith("likely cause"))]
    rounded = rounding_finding(poses.filtered.table, poses.measurements)
    findings = [text for text in (screening.finding, *findings, cause, rounded, uncovered) if text]
    outliers = made.outliers
    if screening.finding:
        outliers = (*left_out(errors, poses.measurements[~screening.kept], whole.p), *outliers)
    return AsBuilt(replace(made, findings=tuple(findings), outliers=outliers), registered.p, measurements)


def _fit(errors: ErrorModel, poses: Measurements, test: np.ndarray, settings: Identify) -> Fit:
    import numpy as np

    from kincal.identification.estimators import estimate_parameters, register

    train = poses[np.setdiff1d(np.arange(len(poses)), test)]
    registered = register(errors, train, settings.max_iterations)
    return Fit(test, registered.p, estimate_parameters(errors, train, settings, registered).p)
