"""Questions to a calibrated robot: predictions, commands, and its accuracy on data that no stage has seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import parts
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import check_readings, quaternions, read_table, to_measurements
from kincal.pipeline.methods.commands import commands
from kincal.pipeline.methods.covariance import pose_covariance, radius, seen_from, sigma
from kincal.pipeline.methods.goal import Goal
from kincal.pipeline.methods.predictors import METHODS, HybridMethod, Method, ModelMethod, build, uncalibrated
from kincal.pipeline.methods.refit import refitted
from kincal.pipeline.methods.scores import scores
from kincal.pipeline.results import RAW, Comparison, Corrected, Identified, Learned
from kincal.pipeline.run.runner import Run
from kincal.urdf.description import RobotDescription, nearest, read_columns
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import AXES


@dataclass(frozen=True)
class Shipped:
    """A robot with what was identified and learned from all measured poses."""

    model: ErrorModel
    identified: Identified
    learned: Learned | None
    corrected: Corrected | None

    @property
    def channels(self) -> tuple[str, ...]:
        return self.identified.shipped.channels

    def methods(self) -> Mapping[str, Method]:
        return build(self.model, self.identified.fits()[0], self.learned, self.corrected, self.channels)


def shipped(session: Run, method: str | None = None) -> Shipped:
    """With the methods that `method` needs; None: all. Networks that nobody asks for are not trained."""
    if method is not None and method not in METHODS:
        raise InputError(f"--method {method}: no such method; {nearest(method, METHODS)}")
    stages = {
        "model": True,
        "identify": True,
        "transfer": method is None or "transfer" in method or method == "network",
        "correct": method in (None, "geometric", "hybrid"),
    }
    wanted = [name for name, needed in stages.items() if needed]
    found = dict(zip(wanted, session.until(*wanted), strict=True))
    description = session.robot.description
    return Shipped(
        ErrorModel.of(found["model"].chain(), description.actuator, description.tolerance),
        found["identify"],
        found["transfer"].fits[0] if "transfer" in found else None,
        found["correct"].fits[0] if "correct" in found else None,
    )


def _read(session: Run, model: ErrorModel, file: Path, columns: Path | None, measured: bool) -> pd.DataFrame:
    """A table as the robot's measurements are read, or with a column map of its own."""
    description, chain = session.robot.description, model.chain
    settings = description.measure
    if columns is not None:
        settings = settings.model_copy(update={"columns": read_columns(columns)})
    elif not measured:
        settings = settings.of_columns(("pose", *chain.actuated_names))
    table = read_table(file, chain.actuated_names, settings, measured=measured)
    check_readings(table, chain, model.actuators, description.tolerance, file)
    return table


def predicted_table(session: Run, file: Path, method: str) -> pd.DataFrame:
    """Poses (one row a row of `file`) as they would be measured: only what was measured can be predicted.

    With `geometric` and `hybrid`: sigmas of the robot's pose, about (along) each axis, root mean square over the axes,
    and the radius of the region that holds it with 95 %, [rad] and [m]; an instrument's noise comes on top. `share` is
    how much of the correction is believed there: 0 far outside the measured poses.
    """
    calibrated = shipped(session, method)
    model, channels = calibrated.model, calibrated.channels
    chosen = calibrated.methods()[method]
    table = _read(session, model, file, None, measured=False)
    readings = table[list(model.chain.actuated_names)].to_numpy(float)
    with _said_of(file):
        pose = chosen.predict(readings)
    r = pose.rotation
    turned = moved = None
    if calibrated.corrected is not None:
        assert isinstance(chosen, ModelMethod | HybridMethod)
        fit = calibrated.identified.fits()[0]
        covariance = pose_covariance(model, fit, calibrated.corrected, chosen, readings)
        turned, moved = covariance[:, :3, :3], covariance[:, 3:, 3:]
    columns: dict[str, np.ndarray] = {"pose": table["pose"].to_numpy()}
    if "orientation" in channels:
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternions(r).T, strict=True)) | _sure("orientation", turned)
    if "position" in channels:
        columns |= dict(zip("xyz", pose.translation.T, strict=True)) | _sure("position", moved)
    if "tilt" in channels:
        columns |= {"roll": np.arctan2(r[:, 2, 1], r[:, 2, 2]), "pitch": -np.arcsin(r[:, 2, 0])}
        columns |= _sure("tilt", None if turned is None else seen_from(turned, r[:, 2]), axes=2)
    if "yaw" in channels:
        up = r[:, 2, :, None]
        columns |= {"yaw": np.arctan2(r[:, 1, 0], r[:, 0, 0])}
        columns |= _sure("yaw", None if turned is None else up.swapaxes(1, 2) @ turned @ up, axes=1)
    if isinstance(chosen, HybridMethod):
        columns["share"] = chosen.correction.share(readings)
    return pd.DataFrame(columns)


def _sure(what: str, covariance: np.ndarray | None, axes: int = 3) -> dict[str, np.ndarray]:
    if covariance is None:
        return {}
    return {f"{what}_std": sigma(covariance, axes), f"{what}_95": radius(covariance)}


def compensated_table(session: Run, file: Path, method: str) -> pd.DataFrame:
    """The actuators' readings that reach the poses of `file` (a measurement table without joints), one row a pose."""
    calibrated = shipped(session, method)
    model, identified = calibrated.model, calibrated.identified
    chosen = calibrated.methods()[method]
    description = session.robot.description
    settings = description.measure.model_copy(update={"columns": {}})
    desired, known, numbers = _desired(read_table(file, (), settings), model, identified, description, file)
    readings = commands(chosen, desired, model.chain, model.actuators, description.workspace, numbers, known)
    return pd.DataFrame({"pose": numbers, **dict(zip(model.chain.actuated_names, readings.T, strict=True))})


def _desired(
    table: pd.DataFrame, model: ErrorModel, identified: Identified, description: RobotDescription, file: Path
) -> tuple[Motion, tuple[str, ...], np.ndarray]:
    """Desired poses, the parts of them that are known, and their numbers.

    Known is what the file says of what was measured. Where that leaves the tool something to choose, the rest of what
    was measured counts, too: there and in all else the file does not say, the poses are as at home.
    """
    wanted = to_measurements(table, (), description.sensor)
    axes = model.chain.tool_axes
    if any(a < 3 for a in axes) and wanted.position is None:
        raise InputError(f"{file}: the tool moves along {[AXES[a] for a in axes if a < 3]}: x, y, z are needed")
    if any(a >= 3 for a in axes) and wanted.orientation is None and wanted.tilt is None:
        raise InputError(f"{file}: the tool turns: qx, qy, qz, qw or roll, pitch (and yaw) are needed")
    robot = model.robot(identified.shipped.change)
    home = robot.measured(model.chain.home_pose)
    pose = wanted.as_poses()
    if wanted.orientation is None and wanted.tilt is None:
        pose = Motion(np.broadcast_to(home.rotation, pose.rotation.shape), pose.translation)
    elif wanted.orientation is None and wanted.yaw is None:
        yaw = np.full(len(wanted), np.arctan2(home.rotation[1, 0], home.rotation[0, 0]))
        pose = replace(wanted, yaw=yaw).as_poses()
    if wanted.position is None:
        pose = Motion(pose.rotation, np.broadcast_to(home.translation, pose.translation.shape))
    measured = identified.shipped.channels
    known = tuple(sorted(parts(wanted.channels) & parts(measured)))
    return pose, known if Goal.of(robot, pose, known).decided() else measured, wanted.pose


@contextmanager
def _said_of(file: Path) -> Iterator[None]:
    """What can't be done with a table's rows is said of its file."""
    try:
        yield
    except InputError as error:
        raise error if str(file) in str(error) else InputError(f"{file}: {error}") from None


def evaluated(session: Run, file: Path, columns: Path | None, *, register: bool, rehome: bool) -> Comparison:
    """The shipped methods against the measurement table `file`.

    register: W is first refitted alone; rehome: the actuators' zeros are. Each method is refitted by its own
    predictions of the table's own poses.
    """
    calibrated = shipped(session)
    model, identified = calibrated.model, calibrated.identified
    table = _read(session, model, file, columns, measured=True)
    measured = to_measurements(table, model.chain.actuated_names, session.robot.description.sensor)
    methods = dict(calibrated.methods())
    if register or rehome:
        with _said_of(file):
            methods = {name: refitted(method, measured, register, rehome) for name, method in methods.items()}
    actual, channels = measured.as_poses(), measured.channels
    return Comparison(
        robot=session.robot.description.name,
        source=session.until("measure")[0].source,
        n_poses=identified.shipped.n_poses,
        n_scored=len(measured),
        scored_on=str(file),
        channels=channels,
        methods=scores(methods, measured, actual, channels),
        held_out=(),
        raw_nominal=scores({RAW: uncalibrated(model)}, measured, actual, channels)[0],
        closed_loop=(),
        not_reached={},
    )
