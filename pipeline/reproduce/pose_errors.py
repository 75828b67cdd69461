"""Errors pose by pose, which the paper's figures 6 and 7 and tables 1 and 2 are made of; cached as a stage's result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.pipeline.results import RAW, Filtered, Hybrids, Identified, Measured, Model, PosePlan, Transferred
from kincal.pipeline.run.fan_out import Job, run_of
from kincal.pipeline.run.stage import stage_of
from kincal.urdf.description import Actuator, Evaluate, Sensor, Split, Tolerance


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
    run, stage = run_of(job), stage_of(pose_errors, ("numpy", "scipy"))
    found = run.beyond(stage)
    return found, (stage.name, run.entries[stage.name].manifest["key"])


def pose_errors(
    model: Model,
    plan: PosePlan,
    measured: Measured,
    filtered: Filtered,
    identified: Identified,
    transferred: Transferred,
    hybrids: Hybrids,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    evaluate: Evaluate,
    seed: int,
) -> PoseErrors:
    """A stage beside those that every robot goes through."""
    from kincal.identification.accuracy import orientation_error
    from kincal.pipeline.methods.predictors import build, uncalibrated
    from kincal.pipeline.stages.fresh_poses import fresh_poses
    from kincal.pipeline.stages.robot_data import error_model, used_poses

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed)
    shipped, held_out = (
        {RAW: uncalibrated(errors)} | dict(build(errors, fit, transferred.fits[k], hybrids.fits[k], poses.channels))
        for k, fit in enumerate(identified.fits()[:2])
    )
    tested = identified.held_out.test
    trained = np.setdiff1d(np.arange(len(poses)), tested)
    assert measured.truth is not None  # `reproduce` takes virtual robots alone
    at, actual = fresh_poses(model, errors, measured.truth, evaluate.fresh_poses, seed)

    def of(methods, readings: np.ndarray, truth: np.ndarray) -> np.ndarray:
        found = [orientation_error(truth, method.predict(readings).rotation) for method in methods.values()]
        return np.rad2deg(np.stack(found))

    seen = poses.as_poses().rotation
    angles = plan.table.set_index("pose").loc[poses.pose, [f"planned_r{axis}" for axis in "xyz"]]
    return PoseErrors(
        methods=tuple(shipped),
        configurations=np.rad2deg(angles.to_numpy()),
        tested=tested,
        training=of(held_out, poses.readings[trained], seen[trained]),
        testing=of(held_out, poses.readings[tested], seen[tested]),
        fresh=of(shipped, at.readings, actual.rotation),
    )
