"""Questions to a calibrated robot: predictions, commands, and its accuracy on data that no stage has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from identification.error_model import ErrorModel
from identification.measurements import check_readings, quaternions, read_table, to_measurements
from pipeline.comparison import RAW, scores
from pipeline.compensation import commands
from pipeline.goal import Goal, parts
from pipeline.methods import METHODS, Method, ModelMethod, build, uncalibrated
from pipeline.refit import refitted
from pipeline.results import Comparison, Identified, Learned
from pipeline.runner import Run
from urdf.description import RobotDescription, nearest, read_columns
from urdf.errors import InputError
from urdf.rigid_motion import Motion
from urdf.workspace import AXES


def _calibrated(session: Run) -> tuple[ErrorModel, Identified, Learned]:
    """The error model, the identification and what was learned from all measured poses."""
    model, identified, transferred = session.until("model", "identify", "transfer")
    description = session.robot.description
    return ErrorModel.of(model.chain(), description.actuator, description.tolerance), identified, transferred.fits[0]


def _method(methods: Mapping[str, Method], name: str) -> Method:
    if name not in methods:
        raise InputError(f"--method {name}: no such method; {nearest(name, METHODS)}")
    return methods[name]


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

    Sigmas are those of the identified parameters, about (along) each axis, root mean square of the three; they hold
    for `geometric` and `hybrid`, and do not count what geometry can't explain.
    """
    model, identified, learned = _calibrated(session)
    channels = identified.shipped.channels
    chosen = _method(build(model, identified.fits()[0], learned, channels), method)
    table = _read(session, model, file, None, measured=False)
    readings = table[list(model.chain.actuated_names)].to_numpy(float)
    numbers = table["pose"].to_numpy()
    pose = chosen.predict(readings)
    turned = moved = np.full(len(numbers), np.nan)
    if isinstance(chosen, ModelMethod) and method != "nominal":
        jacobian = model.pose_jacobian(identified.shipped.change, readings, chosen.close(readings).q)
        variance = np.einsum("nij,jk,nik->ni", jacobian, identified.shipped.covariance, jacobian)
        turned, moved = np.sqrt(variance[:, :3].mean(axis=1)), np.sqrt(variance[:, 3:].mean(axis=1))
    columns: dict[str, np.ndarray] = {"pose": numbers}
    r = pose.rotation
    if "orientation" in channels:
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternions(r).T, strict=True)) | {"orientation_std": turned}
    if "position" in channels:
        columns |= dict(zip("xyz", pose.translation.T, strict=True)) | {"position_std": moved}
    if "tilt" in channels:
        columns |= {"roll": np.arctan2(r[:, 2, 1], r[:, 2, 2]), "pitch": -np.arcsin(r[:, 2, 0]), "tilt_std": turned}
    if "yaw" in channels:
        columns |= {"yaw": np.arctan2(r[:, 1, 0], r[:, 0, 0]), "yaw_std": turned}
    return pd.DataFrame(columns).dropna(axis="columns", how="all")


def compensated_table(session: Run, file: Path, method: str) -> pd.DataFrame:
    """The actuators' readings that reach the poses of `file` (a measurement table without joints), one row a pose."""
    model, identified, learned = _calibrated(session)
    channels = identified.shipped.channels
    chosen = _method(build(model, identified.fits()[0], learned, channels), method)
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


def evaluated(session: Run, file: Path, columns: Path | None, *, register: bool, rehome: bool) -> Comparison:
    """The shipped methods against the measurement table `file`.

    register: W is first refitted alone; rehome: the actuators' zeros are. Each method is refitted by its own
    predictions of the table's own poses.
    """
    model, identified, learned = _calibrated(session)
    table = _read(session, model, file, columns, measured=True)
    measured = to_measurements(table, model.chain.actuated_names, session.robot.description.sensor)
    methods = dict(build(model, identified.fits()[0], learned, identified.shipped.channels))
    if register or rehome:
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
