"""Position axes: a left-handed frame, swapped columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake

_AXES = "xyz"
_BOTH = "positions and orientations are those of a left-handed frame (one axis has the other sign)"
_HANDED = "the positions are those of a left-handed frame: one axis has the other sign, or two columns are swapped"


def mirrored_axis(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One axis with the other sign, alone and together with the orientation."""
    if "position" not in measured.values:
        return
    for k, axis in enumerate(_AXES):
        mirror = np.ones(3)
        mirror[k] = -1.0
        yield Mistake(
            f"{axis} has the other sign (a left-handed frame)", lambda m, s=mirror: _mirrored(m, s, False), _HANDED
        )
        if "orientation" in measured.values:
            both = f"{axis} and the orientation are those of a left-handed frame ({axis} has the other sign)"
            yield Mistake(both, lambda m, s=mirror: _mirrored(m, s, True), _BOTH)


def swapped_axes(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Two columns of the position swapped, or all three in another order."""
    if "position" not in measured.values:
        return
    for order in ([1, 0, 2], [0, 2, 1], [2, 1, 0], [1, 2, 0], [2, 0, 1]):
        moved = [_AXES[k] for k in range(3) if order[k] != k]
        how = (
            f"{' and '.join(moved)} are swapped"
            if len(moved) == 2
            else f"x, y, z hold {', '.join(_AXES[k] for k in order)}"
        )
        inverse = np.argsort(order)
        yield Mistake(f"the columns {how}", lambda m, i=inverse: _permuted(m, i), _HANDED if len(moved) == 2 else "")


def _mirrored(m: Measurements, sign: np.ndarray, orientation: bool) -> Measurements:
    values = {"position": m.values["position"] * sign}
    if orientation:
        values["orientation"] = sign[:, None] * m.values["orientation"] * sign
    return m.replaced(**values)


def _permuted(m: Measurements, order: np.ndarray) -> Measurements:
    return m.replaced(position=m.values["position"][:, order])
