"""An instrument, or a target, that moved during the campaign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import frame_columns, registered, tool_poses
from kincal.urdf.rigid_motion import Motion

_FEWEST = 6  # poses before and after


def moved_instrument(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """The instrument stands elsewhere from some row on; only where all of the pose is measured."""
    if len(measured) < 2 * _FEWEST or not {"orientation", "position"} <= set(measured.values):
        return
    first = _first_row(model, measured)
    if first is not None:
        cause = f"the instrument moved between poses {measured.pose[first - 1]} and {measured.pose[first]}"
        yield Mistake(cause, lambda m: _moved_back(model, m, first))


def _first_row(model: ErrorModel, measured: Measurements) -> int | None:
    """The first row of the second part: where a step of W takes most of the residuals away, to first order."""
    found = registered(model, measured)
    frames, residual, best = frame_columns(found, measured), found.residual, (0.0, None)
    for k in range(_FEWEST, len(measured) - _FEWEST + 1):
        later = np.zeros(len(measured))
        later[k:] = 1.0
        columns = np.concatenate([frames, frames[:, :, :6] * later[:, None, None]], axis=2).reshape(-1, 18)
        left = residual.ravel() - columns @ np.linalg.lstsq(columns, residual.ravel(), rcond=1e-9)[0]
        best = max(best, (float(np.sum(residual**2) - np.sum(left**2)), k), key=lambda pair: pair[0])
    return best[1]


def _moved_back(model: ErrorModel, m: Measurements, first: int) -> Measurements:
    tool, rows = tool_poses(model, m.readings), np.arange(len(m))
    before, after = (registered(model, m[part], tool[part]).robot for part in (rows[:first], rows[first:]))
    back = before.measured(tool)[first] @ after.measured(tool)[first].inverse()
    moved = back @ Motion(m.values["orientation"][first:], m.values["position"][first:])
    rotation, position = m.values["orientation"].copy(), m.values["position"].copy()
    rotation[first:], position[first:] = moved.rotation, moved.translation
    return m.replaced(orientation=rotation, position=position)
