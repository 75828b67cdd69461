"""The robot as built."""

from __future__ import annotations

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
    from kincal.identification.poses import folds, held_out

    errors, measurements, split, seed = poses.errors, poses.measurements, poses.split, poses.seed
    parts = () if measured.truth is not None else folds(len(measurements), split, seed)
    test = held_out(len(measurements), split, seed)
    shipped, registered = as_built(poses, identify)
    measurements = measurements.scaled(shipped.sensor_estimated)
    return Identified(
        shipped=shipped,
        registered=registered,
        held_out=_fit(errors, measurements, test, identify),
        folds=tuple(_fit(errors, measurements, part, identify) for part in parts),
    )


def as_built(poses: Poses, settings: Identify) -> tuple[Identification, np.ndarray]:
    """The robot from all of these poses; and (n_parameters,) W and T alone."""
    from dataclasses import replace

    from kincal.identification.coverage import coverage_finding
    from kincal.identification.diagnosis import registered as register
    from kincal.identification.estimators import estimate_parameters
    from kincal.identification.summary import summarise

    errors, measurements = poses.errors, poses.measurements
    registered = register(errors, measurements, settings.max_iterations)
    whole = estimate_parameters(errors, measurements, settings, registered)
    made = summarise(errors, measurements, whole, registered, settings)
    uncovered = coverage_finding(errors, poses.model.mechanism.workspace, measurements, whole, poses.seed)
    return replace(made, findings=(*made.findings, *([uncovered] if uncovered else []))), registered.p


def _fit(errors: ErrorModel, poses: Measurements, test: np.ndarray, settings: Identify) -> Fit:
    import numpy as np

    from kincal.identification.estimators import estimate_parameters, register

    train = poses[np.setdiff1d(np.arange(len(poses)), test)]
    registered = register(errors, train, settings.max_iterations)
    return Fit(test, registered.p, estimate_parameters(errors, train, settings, registered).p)
