"""Orientations in the notation that [measure] names, Euler angles or a rotation vector, as quaternions.

Angles of `measure.euler` stand in euler_1, euler_2, euler_3, in the order of the axes. An order of three different axes
also takes rx, ry, rz, each about its axis. `measure.rotation_vector` takes rx, ry, rz as one rotation vector.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.channels.orientation import EULER, QUATERNION
from kincal.urdf.description import EULER_ANGLES, Measure, listed
from kincal.urdf.errors import TableError, quoted

_MOST = 2 * np.pi + 1e-6  # [rad] an angle beyond one turn is likely one in degrees


def shadowed(present: Iterable[str], measure: Measure) -> tuple[str, ...]:
    """Columns that are not read where euler_1, euler_2, euler_3 are: rx, ry, rz, which may be the same columns."""
    return EULER if measure.euler and set(EULER_ANGLES) <= set(present) else ()


def as_quaternion(
    columns: Mapping[str, np.ndarray], measure: Measure, file: Path | str, rows: np.ndarray
) -> dict[str, np.ndarray]:
    """The columns (n,) [rad] with qx, qy, qz, qw in place of the notation's. Raises TableError.

    rows: (n,) their numbers in the file, from 0.
    """
    names = _names(columns, measure, file)
    if not names:
        return dict(columns)
    setting = _setting(measure)
    if QUATERNION[0] in columns:
        raise TableError(
            f"{file}: it has {', '.join(QUATERNION)} and {', '.join(names)}: two orientations a row. To use the "
            f"quaternion, delete {setting}; to use the others, delete the columns of the quaternion",
            names[0],
        )
    values = np.column_stack([columns[name] for name in names])
    _check_size(values, names, f"{file}: {setting}", rows)
    rotation = Rotation.from_rotvec(values) if measure.euler is None else Rotation.from_euler(measure.euler, values)
    quaternion = rotation.as_quat(canonical=True)
    others = {name: column for name, column in columns.items() if name not in names}
    return others | dict(zip(QUATERNION, quaternion.T, strict=True))


def check_notation(columns: Iterable[str], present: Iterable[str], measure: Measure, file: Path | str) -> None:
    """Refuse a setting without its columns, and its columns without the setting. Raises TableError.

    columns: canonical ones; present: the table's.
    """
    present = list(present)
    if QUATERNION[0] in set(columns):
        return
    if measure.euler is None and set(EULER_ANGLES) <= set(present):
        raise TableError(
            f'{file}: it has {", ".join(EULER_ANGLES)}: set measure.euler, the order of their axes, such as "ZYX"',
            EULER_ANGLES[0],
        )
    if measure.euler is None and not measure.rotation_vector:
        return
    wanted = EULER if measure.euler is None else EULER_ANGLES
    raise TableError(
        f"{file}: {_setting(measure)} needs the columns {', '.join(wanted)}; it has {listed(present)}. "
        "Name them in [measure.columns]",
        wanted[0],
    )


def _names(columns: Mapping[str, np.ndarray], measure: Measure, file: Path | str) -> Sequence[str]:
    """The columns of the three numbers, in their order; empty where the table has none."""
    if measure.rotation_vector:
        return EULER if EULER[0] in columns else ()
    if measure.euler is None:
        return ()
    if EULER_ANGLES[0] in columns:
        return EULER_ANGLES
    if EULER[0] not in columns:
        return ()
    axes = measure.euler.lower()
    if len(set(axes)) < len(axes):
        raise TableError(
            f"{file}: {_setting(measure)} turns about {axes[0]} twice, but rx, ry, rz are about three axes. Name the "
            "columns of the three angles in [measure.columns] as euler_1, euler_2, euler_3",
            EULER[0],
        )
    return tuple(f"r{axis}" for axis in axes)


def _check_size(values: np.ndarray, names: Sequence[str], where: str, rows: np.ndarray) -> None:
    bad = np.argwhere(np.abs(values) > _MOST)
    if len(bad):
        at, k = bad[0]
        name, row = str(names[k]), int(rows[at])
        raise TableError(
            f"{where}: column {quoted(name)}, row {row + 1}: found {values[at, k]:.6g} rad; allowed are numbers up to "
            f'one turn, 6.28. For degrees, set measure.columns.{name} = {{ from = "{name}", unit = "deg" }}',
            name,
            row,
        )


def _setting(measure: Measure) -> str:
    return "measure.rotation_vector = true" if measure.euler is None else f'measure.euler = "{measure.euler}"'
