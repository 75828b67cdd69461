"""One unknown of the joints, estimated together with W and T at the nominal geometry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.registered import drawn_closure, frame_columns, registered
from kincal.urdf.errors import InputError

_ROUNDS = 3  # linearisations; each gains some digits


def refitted(
    model: ErrorModel,
    measured: Measurements,
    undone: Callable[[float], Measurements],
    small: float,
    most: float = np.inf,
) -> Measurements:
    """`undone(x)` with the x that fits best, from x = 0; small: a step of x for differences.

    Raises InputError; also where x is larger than `most`.
    """
    x, near, q = 0.0, None, None
    for _ in range(_ROUNDS):
        corrected = undone(x)
        at = registered(model, corrected, drawn_closure(model, corrected.readings, q), near)
        near, q = at.robot, at.q
        beside = undone(x + small)
        moved = pose_residual(at.robot.measured(drawn_closure(model, beside.readings, q).pose), beside)
        by_x = ((moved - at.residual) / small)[..., None]
        columns = np.concatenate([by_x, frame_columns(at, corrected)], axis=2).reshape(-1, 13)
        x -= float(np.linalg.lstsq(columns, at.residual.ravel(), rcond=1e-9)[0][0])
    if abs(x) > most:
        raise InputError(f"{x:.3g} is too large a correction")
    return undone(x)
