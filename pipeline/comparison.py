"""The methods on the same poses, which none of them has seen. Everything is predicted in the measurement frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from identification.accuracy import score
from identification.error_model import ErrorModel, require_closed
from identification.measurements import Measurements
from pipeline.results import Comparison, Fit, Identified, MethodScore
from urdf.rigid_motion import Motion

METHODS = ("nominal", "geometric")  # in the order of the table
RAW = "nominal, raw"

Parameters = Mapping[str, np.ndarray]  # {method: (n_parameters,)}


def shipped(identified: Identified) -> Parameters:
    """The methods that predict: fitted on all measured poses."""
    return {"nominal": identified.registered, "geometric": identified.shipped.change}


def of_fit(fit: Fit) -> Parameters:
    return {"nominal": fit.registered, "geometric": fit.identified}


def raw(model: ErrorModel) -> np.ndarray:
    return np.zeros(len(model.parameters))


def predict(model: ErrorModel, p: np.ndarray, measured: Measurements) -> Motion:
    """Poses (n) in the measurement frame at the readings of `measured`. Raises InputError where loops can't close."""
    robot = model.robot(p)
    return robot.measured(require_closed(robot.close(measured.readings), measured).pose)


def scores(
    model: ErrorModel, methods: Parameters, at: Measurements, actual: Motion, channels: tuple[str, ...]
) -> tuple[MethodScore, ...]:
    """One row a method, on poses (n) whose actual values are known."""
    return tuple(_row(name, predict(model, p, at), actual, channels) for name, p in methods.items())


def cross_validated(
    model: ErrorModel, folds: Sequence[Fit], measured: Measurements, channels: tuple[str, ...]
) -> tuple[MethodScore, ...]:
    """One row a method, every pose predicted by the fit that has not seen it."""
    rows = np.concatenate([fold.test for fold in folds])
    actual = measured_poses(measured[rows])
    found = []
    for name in METHODS:
        parts = [predict(model, of_fit(fold)[name], measured[fold.test]) for fold in folds]
        predicted = Motion(np.concatenate([m.rotation for m in parts]), np.concatenate([m.translation for m in parts]))
        found.append(_row(name, predicted, actual, channels))
    return tuple(found)


def measured_poses(measured: Measurements) -> Motion:
    """What was measured, as poses; what was not is the identity, and is not scored."""
    from scipy.spatial.transform import Rotation

    n = len(measured)
    rotation = measured.orientation
    if rotation is None:
        tilt = np.zeros((n, 2)) if measured.tilt is None else measured.tilt
        yaw = np.zeros(n) if measured.yaw is None else measured.yaw
        rotation = Rotation.from_euler("ZYX", np.column_stack([yaw, tilt[:, 1], tilt[:, 0]])).as_matrix()
    return Motion(rotation, np.zeros((n, 3)) if measured.position is None else measured.position)


def _row(name: str, predicted: Motion, actual: Motion, channels: tuple[str, ...]) -> MethodScore:
    return MethodScore(name=name, **asdict(score(actual, predicted, channels)))


def to_json(comparison: Comparison) -> dict:
    """The document of `compare --json` and `evaluate --json`."""
    return asdict(comparison)
