"""Errors pose by pose, which the paper's figures 6 and 7 and tables 1 and 2 are made of; cached as a stage's result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from pipeline.artifacts import Damaged, Store, digest
from pipeline.fan_out import Job, carry_out
from pipeline.fingerprint import Code
from pipeline.results import Hybrids, Identified, Measured, Model, PosePlan, Transferred
from pipeline.runner import Run
from urdf.description import RobotDescription, load_robot

_NAME = "pose_errors"
_SETTINGS = ("sensor", "tolerance", "actuator", "split", "evaluate", "seed")


@dataclass(frozen=True)
class PoseErrors:
    """Orientation errors [deg] about x, y and z (eq. 8) of each method: the held-out fit's, and the shipped one's."""

    methods: tuple[str, ...]
    configurations: np.ndarray  # (n, 3) measured: planned angles about x, y, z [deg]
    tested: np.ndarray  # (k,) rows of them that the held-out fit has not seen
    training: np.ndarray  # (methods, n - k, 3) the poses that it has seen, as measured
    testing: np.ndarray  # (methods, k, 3) as measured: the paper's way
    fresh: np.ndarray  # (methods, m, 3) by the fit of all poses, on fresh ones without noise


def errors_of(job: Job) -> PoseErrors:
    """Of a job whose stages are in the store; made there where they are not."""
    digests = {passed.stage: passed.digest for passed in carry_out(job).passed}
    robot, store = load_robot(job.robot, job.overrides), Store(job.store)
    code = Code(memo=store.read_memo())
    parts = {
        "code": code.fingerprint(__name__, _NAME),
        "inputs": digests,
        "settings": {name: to_jsonable_python(getattr(robot.description, name), by_alias=True) for name in _SETTINGS},
    }
    key = digest(parts)
    found = _cached(store, key)
    if found is not None:
        return found
    names = ("model", "plan", "measure", "filter", "identify", "transfer", "correct")
    with store.lock(_NAME, key):
        value = pose_errors(*Run(robot, store, command=job.command, _code=code).until(*names), robot=robot.description)
        store.save(_NAME, key, value, {"parts": parts})
    store.write_memo(code.used)
    return value


def _cached(store: Store, key: str) -> PoseErrors | None:
    try:
        entry = store.find(_NAME, key)
        return None if entry is None else store.load(entry, PoseErrors)
    except Damaged as damage:
        store.set_aside(damage.folder)
        return None


def pose_errors(
    model: Model,
    plan: PosePlan,
    measured: Measured,
    filtered: Any,
    identified: Identified,
    transferred: Transferred,
    hybrids: Hybrids,
    robot: RobotDescription,
) -> PoseErrors:
    from identification.accuracy import orientation_error
    from identification.error_model import ErrorModel
    from pipeline.comparison import RAW
    from pipeline.methods import build, uncalibrated
    from pipeline.stages import _fresh, _used

    chain = model.chain()
    errors = ErrorModel.of(chain, robot.actuator, robot.tolerance)
    poses = _used(filtered, chain, robot.sensor, robot.split, robot.seed)
    shipped, held_out = (
        {RAW: uncalibrated(errors)} | dict(build(errors, fit, transferred.fits[k], hybrids.fits[k], poses.channels))
        for k, fit in enumerate(identified.fits()[:2])
    )
    tested = identified.held_out.test
    trained = np.setdiff1d(np.arange(len(poses)), tested)
    at, actual = _fresh(model, errors, measured.truth, robot.evaluate.fresh_poses, robot.seed)

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
