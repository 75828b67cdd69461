"""Orientations in another notation than rx, ry, rz of intrinsic XYZ angles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.registered import drawn_closure, registered
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import Closure
from kincal.urdf.rigid_motion import log, wrap

_PROPER = ("ZYZ", "ZXZ", "XYX", "XZX", "YXY", "YZY")
_OTHERS = ("XZY", "YXZ", "YZX", "ZXY", "ZYX")


def other_notation(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """A rotation vector, fixed axes, another order of axes; angles by their axis, or in the order of the rotations."""
    if "orientation" not in measured.values:
        return
    yield Mistake(
        "rx, ry, rz hold a rotation vector, not intrinsic XYZ angles (measure.rotation_vector = true)",
        lambda m: _read(model, m, None),
    )
    for order in _OTHERS:
        fixed = "".join(reversed(order))
        cause = f"rx, ry, rz are angles about fixed axes in the order {fixed} (intrinsic {order}), not intrinsic XYZ"
        cause += f' (measure.euler = "{order}")'
        yield Mistake(cause, lambda m, o=order: _read(model, m, o))
    for order in _PROPER:
        for columns, names in (((2, 1, 0), "rz, ry, rx"), ((0, 1, 2), "rx, ry, rz")):
            cause = f"{names} are Euler angles {order}, not intrinsic XYZ angles"
            cause += f' (measure.euler = "{order}", columns euler_1, euler_2, euler_3)'
            yield Mistake(cause, lambda m, o=order, c=columns: _read(model, m, o, c))


def _read(
    model: ErrorModel, m: Measurements, order: str | None, columns: tuple[int, ...] | None = None
) -> Measurements:
    """The measurements with orientations read anew; order: None: a rotation vector. Raises InputError."""
    angles = Rotation.from_matrix(m.values["orientation"]).as_euler("XYZ")
    chosen = list(columns or (tuple("XYZ".index(axis) for axis in order) if order else ()))

    def rotation(xyz: np.ndarray) -> np.ndarray:
        one = Rotation.from_rotvec(xyz) if order is None else Rotation.from_euler(order, xyz[:, chosen])
        return one.as_matrix()

    read = rotation(angles)
    if np.abs(angles[:, [0, 2]]).max() > np.pi / 2:  # the middle angle in the table may have been beyond 90 degrees
        x, y, z = angles.T
        other = rotation(np.stack([wrap(x + np.pi), wrap(np.pi - y), wrap(z + np.pi)], axis=-1))
        closure = drawn_closure(model, m.readings)
        first = _nearer(closure.pose.rotation, read, other)[:, None, None]
        # where the other reading is the same in other frames, W and T of the positions tell which it is
        both = [m.replaced(orientation=np.where(w, read, other)) for w in (first, ~first)]
        return min(both, key=lambda one: _size(model, one, closure))
    return m.replaced(orientation=read)


def _size(model: ErrorModel, m: Measurements, closure: Closure) -> float:
    try:
        return registered(model, m, closure).size
    except InputError:
        return np.inf


def _nearer(drawn: np.ndarray, read: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) bool: whether of two readings of each orientation (n, 3, 3) the first is more like the drawn ones.

    By how far the target turned between two poses, which does not depend on W and T.
    """
    both = np.stack([read, other])
    n = len(drawn)
    best, result = np.inf, np.ones(n, dtype=bool)
    for first in both[:, 0]:
        chosen, apart, is_read = read, np.inf, result
        for rows in (np.array([0]), np.arange(n)):  # by the first pose, then by all as chosen
            reference = first[None] if len(rows) == 1 else chosen
            turned = _angles(np.einsum("bnij,mkj->bnmik", both, reference))
            gap = np.abs(turned - _angles(np.einsum("nij,mkj->nmik", drawn, drawn[rows])))
            size = np.median(gap, axis=2)  # (2, n)
            is_read, apart = size[0] <= size[1], float(np.sum(size.min(axis=0)))
            chosen = np.where(is_read[:, None, None], read, other)
        if apart < best:
            best, result = apart, is_read
    return result


def _angles(rotation: np.ndarray) -> np.ndarray:
    """Of rotations (..., 3, 3) [rad]."""
    return np.linalg.norm(log(rotation), axis=-1)
