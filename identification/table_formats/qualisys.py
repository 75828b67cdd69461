"""TSV files that Qualisys Track Manager (QTM) exports: rigid bodies (6D) or markers (3D), in millimetres.

Above stand keys and their values, a line each. Then a line may name the columns. A body has X, Y, Z, three angles, a
residual and its rotation matrix, column by column. The angles may have any definition: the matrix is read.
A lost body or marker is a row of zeros or blanks.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from kincal.identification.table_formats.export import Source, Target, cells, chosen, described, frames, quaternions
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError

_KEY = re.compile(r"[A-Z][A-Z_]+")
_FIRST = ("NO_OF_FRAMES", "FILE_VERSION")
_NAMES = ("BODY_NAMES", "MARKER_NAMES")
_MATRIX = tuple(f"Rot[{k}]" for k in range(9))
_OF_BODY = ("X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *_MATRIX)
_MM = 1e-3
_NO_ROTATION = 0.05  # determinant of a matrix off 1


class _Qualisys:
    name = "Qualisys"

    def recognises(self, lines: Sequence[str]) -> bool:
        keys = _keys(lines)
        return bool(lines) and lines[0].split("\t")[0] in _FIRST and any(keys.get(name) for name in _NAMES)

    def read(self, source: Source, measure: Measure) -> pd.DataFrame:
        keys = _keys(source.lines)
        begin = next((k for k, line in enumerate(source.lines) if not _is_key(line)), len(source.lines))
        rows = [
            [cell.strip() for cell in line.rstrip("\t\r\n").split("\t")] for line in source.lines[begin : begin + 1]
        ]
        names, named = _columns(rows[0] if rows else [], keys)
        target = chosen(_targets(names, keys), measure.body, source.file)
        wanted = (*target.position, *target.rotation, *(k for k, name in enumerate(names) if name in ("Frame", "Time")))
        table = cells(source, begin + named, "\t", wanted)
        position = table[list(target.position)].to_numpy(copy=True)
        matrix = table[list(target.rotation)].to_numpy(copy=True) if target.rotation else None
        lost = (position == 0).all(axis=1) & (True if matrix is None else (matrix == 0).all(axis=1))
        position[lost] = np.nan
        rotation = None if matrix is None else _rotation(matrix, lost, source)
        frame, t = _time(table, names, keys, source)
        return described(frames(frame, t, _MM * position, rotation), source, self.name, target)


def _is_key(line: str) -> bool:
    return _KEY.fullmatch(line.split("\t")[0].strip()) is not None


def _keys(lines: Sequence[str]) -> dict[str, list[str]]:
    keys = {}
    for line in lines:
        if not _is_key(line):
            break
        key, *values = (cell.strip() for cell in line.split("\t"))
        keys[key] = [value for value in values if value]
    return keys


def _columns(row: Sequence[str], keys: dict[str, list[str]]) -> tuple[list[str], bool]:
    """The names of the columns, and whether the row has them; else the row is the first frame."""
    if not _is_number(row[0] if row else ""):
        return list(row), True
    parts = _OF_BODY if "BODY_NAMES" in keys else _OF_BODY[:3]
    names = [f"{name} {part}" for name in _target_names(keys) for part in parts]
    return (["Frame", "Time", *names] if len(row) == len(names) + 2 else names), False


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _target_names(keys: dict[str, list[str]]) -> list[str]:
    return next((keys[name] for name in _NAMES if keys.get(name)), [])


def _targets(names: Sequence[str], keys: dict[str, list[str]]) -> list[Target]:
    """A target begins at each column X; its other columns follow up to the next."""
    starts = [k for k, name in enumerate(names) if name == "X" or name.endswith(" X")]
    targets = []
    for number, (k, end) in enumerate(zip(starts, [*starts[1:], len(names)], strict=True)):
        parts = {name.rpartition(" ")[2]: k + i for i, name in enumerate(names[k:end])}
        listed = _target_names(keys)
        name = names[k][:-2] or (listed[number] if number < len(listed) else str(number + 1))
        if {"X", "Y", "Z"} <= set(parts):
            matrix = tuple(parts[part] for part in _MATRIX if part in parts)
            targets.append(Target(name, tuple(parts[axis] for axis in "XYZ"), matrix if len(matrix) == 9 else ()))
    return targets


def _rotation(matrix: np.ndarray, lost: np.ndarray, source: Source) -> np.ndarray:
    """(n, 4) quaternions of matrices (n, 9), column by column."""

    def converted(rows: np.ndarray) -> Rotation:
        columns = rows.reshape(-1, 3, 3)
        if (np.abs(np.linalg.det(columns) - 1) > _NO_ROTATION).any():
            raise InputError(f"{source.file}: Rot[0] to Rot[8] of some frames are no rotation matrix")
        return Rotation.from_matrix(columns.swapaxes(1, 2))

    matrix[lost] = np.nan
    return quaternions(matrix, converted)


def _time(
    table: pd.DataFrame, names: Sequence[str], keys: dict[str, list[str]], source: Source
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the frames, and their times [s]; from the frequency where the file has no column."""
    counted = np.arange(1.0, len(table) + 1)
    frame = table[names.index("Frame")].to_numpy() if "Frame" in names else counted
    if "Time" in names:
        return frame, table[names.index("Time")].to_numpy()
    rate = (keys.get("FREQUENCY") or [""])[0]
    if not _is_number(rate) or not float(rate) > 0:
        return frame, np.full(len(table), np.nan)
    return frame, (counted - 1) / float(rate)


QUALISYS = _Qualisys()
