"""One unknown of the joints, estimated together with W and T at the nominal geometry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.registered import frame_columns, registered, tool_poses

_ROUNDS = 3  # linearisations; each gains some digits


def refitted(
    model: ErrorModel, measured: Measurements, undone: Callable[[float], Measurements], small: float
) -> Measurements:
    """`undone(x)` with the x that fits best, from x = 0; small: a step of x for differences. Raises InputError."""
    x, near = 0.0, None
    for _ in range(_ROUNDS):
        corrected = undone(x)
        found = registered(model, corrected, near=near)
        near = found.robot
        beside = undone(x + small)
        moved = pose_residual(found.robot.measured(tool_poses(model, beside.readings)), beside)
        by_x = ((moved - found.residual) / small)[..., None]
        columns = np.concatenate([by_x, frame_columns(found, corrected)], axis=2).reshape(-1, 13)
        x -= float(np.linalg.lstsq(columns, found.residual.ravel(), rcond=1e-9)[0][0])
    return undone(x)
