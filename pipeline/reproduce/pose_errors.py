"""Errors pose by pose, which the paper's figures 6 and 7 and tables 1 and 2 are made of; cached as a stage's result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.pipeline.learned import Fits
from kincal.pipeline.results import RAW, Measured, PosePlan
from kincal.pipeline.run.fan_out import Job, run_of
from kincal.pipeline.run.stage import stage_of
from kincal.pipeline.stages.robot_data import Poses
from kincal.urdf.description import Evaluate


@dataclass(frozen=True)
class PoseErrors:
    """Orientation errors [deg] about x, y and z (eq. 8) of each method: the held-out fit's, and the shipped one's."""

    methods: tuple[str, ...]
    configurations: np.ndarray  # (n, 3) measured: planned angles about x, y, z [deg]
    tested: np.ndarray  # (k,) rows of them that the held-out fit has not seen
    training: np.ndarray  # (methods, n - k, 3) the poses that it has seen, as measured
    testing: np.ndarray  # (methods, k, 3) as measured: the paper's way
    fresh: np.ndarray  # (methods, m, 3) by the fit of all poses, on fresh ones without noise


def errors_of(job: Job) -> tuple[PoseErrors, tuple[str, str]]:
    """Of a job whose stages are in the store, made there where they are not; and (stage, key) of their artifact."""
    run, stage = run_of(job), stage_of("pose_errors", pose_errors, ("numpy", "scipy"))
    errors = run.beyond(stage)
    return errors, (stage.name, run.entries[stage.name].manifest["key"])


def pose_errors(poses: Poses, fits: Fits, plan: PosePlan, measured: Measured, evaluate: Evaluate) -> PoseErrors:
    """A stage beside those that every robot goes through."""
    from kincal.identification.accuracy import orientation_error
    from kincal.pipeline.methods.calibrated import calibrations
    from kincal.pipeline.methods.predictors import uncalibrated
    from kincal.pipeline.stages.fresh_poses import fresh_poses

    errors, measurements = poses.errors, poses.fitted(fits.identified)
    calibrated = calibrations(errors, fits.identified, fits.transferred, fits.hybrids)
    shipped, held_out = ({RAW: uncalibrated(errors), **c.methods} for c in calibrated[:2])
    tested = fits.identified.held_out.test
    trained = np.setdiff1d(np.arange(len(measurements)), tested)
    assert measured.truth is not None  # `reproduce` takes virtual robots alone
    at, actual = fresh_poses(poses, measured.truth, evaluate.fresh_poses, poses.seed)

    def of(methods, readings: np.ndarray, truth: np.ndarray) -> np.ndarray:
        errors_by_method = [orientation_error(truth, method.predict(readings).rotation) for method in methods.values()]
        return np.rad2deg(np.stack(errors_by_method))

    seen = measurements.as_poses().rotation
    angles = plan.table.set_index("pose").loc[measurements.pose, [f"planned_r{axis}" for axis in "xyz"]]
    return PoseErrors(
        methods=tuple(shipped),
        configurations=np.rad2deg(angles.to_numpy()),
        tested=tested,
        training=of(held_out, measurements.readings[trained], seen[trained]),
        testing=of(held_out, measurements.readings[tested], seen[tested]),
        fresh=of(shipped, at.readings, actual.rotation),
    )
