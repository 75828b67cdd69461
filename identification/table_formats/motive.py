"""CSV files that OptiTrack's Motive exports (format version 1.2 and later).

The first line has settings in pairs. Below, each column is named by several lines: type, name, ID, (parent,) rotation
or position, and the axis. Euler angles are in degrees, about the axes of the body as it turns, each column by its axis.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from kincal.identification.table_formats.export import Source, Target, cells, chosen, described, frames, quaternions
from kincal.urdf.description import EULER_ORDERS, Measure
from kincal.urdf.errors import InputError, quoted

_LENGTHS = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254, "feet": 0.3048}
_BODIES, _MARKERS = ("rigid body", "bone", "trained markerset"), ("marker",)  # of markers: those that were seen
_FAR = 1e3  # of numbers that are no quaternion's
_LENGTH_TOLERANCE = 5e-3  # of a quaternion: three printed decimals
_FIRST = "Frame"  # begins the line of the axes


@dataclass(frozen=True)
class _Header:
    settings: dict[str, str]
    kinds: list[str]
    names: list[str]
    parts: list[str]  # rotation or position
    axes: list[str]
    data: int  # line of the first frame


class _Motive:
    name = "Motive"

    def recognises(self, lines: Sequence[str]) -> bool:
        return (
            bool(lines) and lines[0].lstrip('"').startswith("Format Version") and _axes_line(_rows(lines)) is not None
        )

    def read(self, source: Source, measure: Measure) -> pd.DataFrame:
        header = _header(source)
        target = chosen(_targets(header), measure.body, source.file)
        table = cells(source, header.data, ",", (0, 1, *target.position, *target.rotation))
        length = _setting(header, "Length Units", source, tuple(_LENGTHS))
        position = table[list(target.position)].to_numpy() * _LENGTHS[length]
        rotation = None
        if target.rotation:
            rotation = _rotation(header, table[list(target.rotation)].to_numpy(), target, source, measure)
        result = frames(table[0].to_numpy(), table[1].to_numpy(), position, rotation)
        return described(result.loc[np.isfinite(table[0].to_numpy())].reset_index(drop=True), source, self.name, target)


def _rows(lines: Sequence[str]) -> list[list[str]]:
    return [[cell.strip() for cell in row] for row in (next(csv.reader([line]), []) for line in lines)]


def _axes_line(rows: Sequence[Sequence[str]]) -> int | None:
    return next((k for k, row in enumerate(rows) if k and row and row[0] == _FIRST), None)


def _header(source: Source) -> _Header:
    rows = _rows(source.lines)
    k = _axes_line(rows)
    assert k is not None
    named = [row for row in rows[1:k] if any(row)]
    if len(named) < 3:
        raise InputError(f"{source.file}: a Motive export without the lines that name its columns; export them, too")
    settings = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    return _Header(settings, named[0], named[1], named[-1], rows[k], k + 1)


def _targets(header: _Header) -> list[Target]:
    """Rigid bodies and bones with position and rotation, then markers; in the file's order."""
    columns: dict[tuple[str, str], dict[str, list[int]]] = {}
    rows = (header.kinds, header.names, header.parts, header.axes)
    for k, (kind, name, part, axis) in enumerate(zip(*rows, strict=False)):
        if k > 1 and kind.lower() in (*_BODIES, *_MARKERS) and axis in tuple("XYZW"):
            columns.setdefault((kind.lower(), name), {}).setdefault(part, []).append(k)
    targets = []
    for (kind, name), parts in columns.items():
        position, rotation = parts.get("Position", []), parts.get("Rotation", []) if kind in _BODIES else []
        for k in range(0, len(position) - 2, 3):  # several: markers that have no name of their own
            x, y, z = position[k : k + 3]
            if "".join(header.axes[i] for i in (x, y, z)) == "XYZ":
                targets.append(Target(name, (x, y, z), tuple(rotation)))
    return targets


def _rotation(header: _Header, values: np.ndarray, target: Target, source: Source, measure: Measure) -> np.ndarray:
    """(n, 4) quaternions x, y, z, w of columns that are named by their axes."""
    by_axis = {header.axes[k]: values[:, i] for i, k in enumerate(target.rotation)}
    if not {"X", "Y", "Z"} <= set(by_axis):
        shown = ", ".join(by_axis)
        raise InputError(
            f"{source.file}: rotation of {quoted(target.name)}: found the columns {shown}; needed are X, Y, Z"
        )
    if "W" in by_axis:
        return _of_quaternions(np.column_stack([by_axis[axis] for axis in "XYZW"]), source)
    allowed = tuple(order for order in EULER_ORDERS if len(set(order)) == 3)
    order = measure.euler if measure.euler in allowed else _setting(header, "Rotation Type", source, allowed)
    angles = np.column_stack([by_axis[axis] for axis in order.upper()])
    return quaternions(angles, lambda rows: Rotation.from_euler(order, rows, degrees=True))


def _of_quaternions(values: np.ndarray, source: Source) -> np.ndarray:
    values[(values == 0).all(axis=1)] = np.nan
    length = np.linalg.norm(np.nan_to_num(np.clip(values, -_FAR, _FAR), nan=0.5), axis=1)
    bad = np.flatnonzero(np.isfinite(values).all(axis=1) & (np.abs(length - 1) > _LENGTH_TOLERANCE))
    if len(bad):
        raise InputError(
            f"{source.file}: frame in row {bad[0] + 1}: the quaternion's length is {length[bad[0]]:.4g}; allowed is 1"
        )
    return quaternions(values, Rotation.from_quat)


def _setting(header: _Header, key: str, source: Source, allowed: Sequence[str]) -> str:
    value = header.settings.get(key, "")
    known = next((text for text in allowed if text.casefold() == value.split(" ")[0].casefold()), None)
    if known is None:
        shown = ", ".join(text for text in allowed if not text.islower() or allowed[0].islower())
        raise InputError(f"{source.file}: first line, {key}: found {quoted(value)}; allowed are {shown}")
    return known


MOTIVE = _Motive()
