"""Questions to a calibrated robot: predictions, and its accuracy on data that no stage has seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from identification.error_model import ErrorModel, require_closed
from identification.estimators import refit
from identification.measurements import Measurements, check_readings, quaternions, read_table, to_measurements
from pipeline.comparison import METHODS, RAW, measured_poses, raw, scores, shipped
from pipeline.results import Comparison, Identified
from pipeline.runner import Run
from urdf.description import nearest, read_columns
from urdf.errors import InputError


def _identified(session: Run) -> tuple[ErrorModel, Identified]:
    model, identified = session.until("model", "identify")
    description = session.robot.description
    return ErrorModel.of(model.chain(), description.actuator, description.tolerance), identified


def _read(session: Run, model: ErrorModel, file: Path, columns: Path | None, measured: bool) -> pd.DataFrame:
    """A table as the robot's measurements are read, or with a column map of its own."""
    description = session.robot.description
    settings = description.measure
    if columns is not None:
        settings = settings.model_copy(update={"columns": read_columns(columns)})
    elif not measured:
        joints = {k: v for k, v in settings.columns.items() if k in description.actuated}
        settings = settings.model_copy(update={"columns": joints})
    chain = model.chain
    table = read_table(file, chain.actuated_names, settings, measured=measured)
    check_readings(table, chain, model.actuators, description.tolerance, file)
    return table


def predicted_table(session: Run, file: Path, method: str) -> pd.DataFrame:
    """Poses (one row a row of `file`) as they would be measured: only what was measured can be predicted.

    Sigmas are about (along) each axis, root mean square of the three, and hold for `geometric` alone.
    """
    model, identified = _identified(session)
    methods = shipped(identified)
    if method not in methods:
        raise InputError(f"--method {method}: no such method; {nearest(method, METHODS)}")
    table = _read(session, model, file, None, measured=False)
    readings = table[list(model.chain.actuated_names)].to_numpy(float)
    at = Measurements(table["pose"].to_numpy(), readings)
    p = methods[method]
    robot = model.robot(p)
    closure = require_closed(robot.close(readings), at)
    pose = robot.measured(closure.pose)
    columns: dict[str, np.ndarray] = {"pose": at.pose}
    channels, r = identified.shipped.channels, pose.rotation
    variance = np.full((len(at), 6), np.nan)
    if method == "geometric":
        jacobian = model.pose_jacobian(p, readings, closure.q)
        variance = np.einsum("nij,jk,nik->ni", jacobian, identified.shipped.covariance, jacobian)
    turned = np.sqrt(variance[:, :3].mean(axis=1))
    if "orientation" in channels:
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternions(r).T, strict=True)) | {"orientation_std": turned}
    if "position" in channels:
        columns |= dict(zip("xyz", pose.translation.T, strict=True))
        columns["position_std"] = np.sqrt(variance[:, 3:].mean(axis=1))
    if "tilt" in channels:
        columns |= {"roll": np.arctan2(r[:, 2, 1], r[:, 2, 2]), "pitch": -np.arcsin(r[:, 2, 0]), "tilt_std": turned}
    if "yaw" in channels:
        columns["yaw"] = np.arctan2(r[:, 1, 0], r[:, 0, 0])
    found = pd.DataFrame(columns)
    return found.dropna(axis="columns", how="all")


def evaluated(session: Run, file: Path, columns: Path | None, *, register: bool, rehome: bool) -> Comparison:
    """The shipped methods against the measurement table `file`.

    register: W is first refitted alone; rehome: the actuators' zeros are. Both use the table's own poses.
    """
    model, identified = _identified(session)
    description = session.robot.description
    table = _read(session, model, file, columns, measured=True)
    measured = to_measurements(table, model.chain.actuated_names, description.sensor)
    methods = {name: _moved(model, measured, p, register, rehome) for name, p in shipped(identified).items()}
    actual = measured_poses(measured)
    channels = measured.channels
    return Comparison(
        robot=description.name,
        source=session.until("measure")[0].source,
        n_poses=identified.shipped.n_poses,
        n_scored=len(measured),
        scored_on=str(file),
        channels=channels,
        methods=scores(model, methods, measured, actual, channels),
        held_out=(),
        raw_nominal=scores(model, {RAW: raw(model)}, measured, actual, channels)[0],
    )


def _moved(model: ErrorModel, measured: Measurements, p: np.ndarray, register: bool, rehome: bool) -> np.ndarray:
    free = np.zeros(len(p), dtype=bool)
    n = len(model.actuators.gain)
    free[-12:-6] = register
    free[-12 - 2 * n : -12 - n] = rehome
    return refit(model, measured, p, free).p if free.any() else p
