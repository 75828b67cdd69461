"""Orientations in another notation than rx, ry, rz of intrinsic XYZ angles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake

_PROPER = ("ZYZ", "ZXZ", "XYX", "XZX", "YXY", "YZY")
_OTHERS = ("XZY", "YXZ", "YZX", "ZXY", "ZYX")


def other_notation(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """A rotation vector, fixed axes, another order of axes; angles by their axis, or in the order of the rotations."""
    if "orientation" not in measured.values:
        return
    yield Mistake("rx, ry, rz hold a rotation vector, not intrinsic XYZ angles", lambda m: _read(m, None))
    for order in _OTHERS:
        fixed = "".join(reversed(order))
        cause = f"rx, ry, rz are angles about fixed axes in the order {fixed} (intrinsic {order}), not intrinsic XYZ"
        yield Mistake(cause, lambda m, o=order: _read(m, o))
    for order in _PROPER:
        for columns, names in (((2, 1, 0), "rz, ry, rx"), ((0, 1, 2), "rx, ry, rz")):
            cause = f"{names} are Euler angles {order}, not intrinsic XYZ angles"
            yield Mistake(cause, lambda m, o=order, c=columns: _read(m, o, c))


def _read(m: Measurements, order: str | None, columns: tuple[int, ...] | None = None) -> Measurements:
    angles = Rotation.from_matrix(m.values["orientation"]).as_euler("XYZ")
    if order is None:
        rotation = Rotation.from_rotvec(angles)
    else:
        chosen = columns or tuple("XYZ".index(axis) for axis in order)
        rotation = Rotation.from_euler(order, angles[:, np.array(chosen)])
    return m.replaced(orientation=rotation.as_matrix())
