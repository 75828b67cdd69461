"""The measurement table: reading, checking, units. One row a static pose."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import CHANNELS
from kincal.identification.channels.orientation import quaternions as quaternions
from kincal.identification.column_names import matched, misspelt, unused, unused_note
from kincal.identification.table_files import floats, load
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Column, Measure, Tolerance, listed, nearest
from kincal.urdf.errors import InputError, TableError

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "1": 1.0}
UNITS |= {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GROUPS = tuple(group for c in CHANNELS for group in (c.columns, *c.other_columns))
_LARGEST = 1e15  # a number beyond is no reading; below, whole numbers are exact and squares don't overflow
_ALLOWED = "; ".join(", ".join(group) for group in _GROUPS)


def read_table(file: Path, joints: Sequence[str], measure: Measure, measured: bool = True) -> pd.DataFrame:
    """A file as the canonical table; see `canonical_table`."""
    return noted_table(file, joints, measure, measured)[0]


def noted_table(
    file: Path, joints: Sequence[str], measure: Measure, measured: bool = True
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A file as the canonical table, and notes on what was not used."""
    raw = load(file, measure, _known(joints))
    return canonical_table(raw, joints, measure, file, measured), table_notes(raw, joints, measure, file)


def canonical_table(
    raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str, measured: bool = True
) -> pd.DataFrame:
    """A table as somebody brought it -> pose, one column a joint, and the measured columns it has; SI units.

    file: where it came from, for messages.
    measured: whether something must have been measured; a table of joint values alone is fine otherwise.
    Raises InputError that names the file, the column, the row and the value.
    """
    if not len(raw):
        raise TableError(f"{file}: the table is empty; at least one row is needed")
    known = _known(joints)
    for name in measure.columns:
        if name not in known:
            raise InputError(
                f"{file}: measure.columns: {name!r} is no column of a measurement table; {nearest(name, known)}"
            )
    rows = np.arange(len(raw))
    if measured:
        rows = np.flatnonzero(~_unmeasured(raw, joints, measure))
        rows = rows if len(rows) else np.arange(len(raw))
    raw, attributes = raw.iloc[rows], raw.attrs
    columns: dict[str, np.ndarray] = {"pose": rows}
    sources = _with_units(_sources(raw.columns, joints, measure), attributes.get("units", {}))
    for name in known:
        if name in sources:
            values = raw[sources[name].source]
            columns[name] = numbers(values.tolist(), sources[name], file, rows)
        elif name in measure.columns or name in joints:
            source, has = measure.columns[name].source if name in measure.columns else name, listed(raw.columns)
            raise TableError(f"{file}: column {source!r} ({name}) is missing; it has {has}", source)
    if measured:
        _check_spelling(raw.columns, sources, known, file)
    _check_groups(columns, file, measured)
    _check_rows(columns, file)
    for channel in CHANNELS:
        columns = channel.canonical(columns)
    return pd.DataFrame(columns)


def _unmeasured(raw: pd.DataFrame, joints: Sequence[str], measure: Measure) -> np.ndarray:
    """(n,) rows that have joint values, and nothing in any measured column: the target was not seen there."""
    sources = _sources(raw.columns, joints, measure)
    seen = [column.source for name, column in sources.items() if name not in ("pose", *joints)]
    if not seen:
        return np.zeros(len(raw), dtype=bool)
    blank = raw[seen].map(lambda v: v is None or v != v or (isinstance(v, str) and not v.strip()))
    return np.asarray(blank.to_numpy(bool).all(axis=1))


def table_notes(raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str) -> tuple[str, ...]:
    """What a user should know of the columns: those that nothing uses, named once."""
    used = {column.source for column in _sources(raw.columns, joints, measure).values()}
    blank = np.flatnonzero(_unmeasured(raw, joints, measure))
    skipped = f"{file}: {len(blank)} of {len(raw)} rows have no measurement and are skipped: rows {listed(blank + 1)}"
    others = [name for name in unused(list(raw.columns), used) if not name.startswith("planned_")]  # of `kincal plan`
    notes = [*raw.attrs.get("notes", ()), *([skipped] if 0 < len(blank) < len(raw) else [])]
    return (*notes, *([f"{file}: {unused_note(others)}"] if others else []))


def _known(joints: Sequence[str]) -> list[str]:
    return ["pose", *joints, *(c for group in _GROUPS for c in group), *(f"{c.name}_std" for c in CHANNELS)]


def _sources(present: Iterable[str], joints: Sequence[str], measure: Measure) -> dict[str, Column]:
    """{canonical name: the column that has it, and its unit}."""
    names, sources = [str(name) for name in present], {}
    plain = matched(names, _known(joints))
    mapped = matched(names, [column.source for column in measure.columns.values()])
    for name in _known(joints):
        column = measure.columns.get(name)
        if column is not None and column.source in mapped:
            sources[name] = column.model_copy(update={"source": mapped[column.source]})
        elif name in plain:  # a canonical table needs no map
            sources[name] = Column.model_validate({"from": plain[name]})
    return sources


def _with_units(sources: Mapping[str, Column], units: Mapping[str, str]) -> dict[str, Column]:
    """Units of a row of units, where the column map names none; degrees and lengths of what is measured alone."""
    lengths, angles = ("m", "mm", "cm", "in"), ("rad", "deg", "rev")
    allowed = {name: lengths if c.column_unit == "m" else angles if c.column_unit == "rad" else () for c in CHANNELS
               for group in (c.columns, *c.other_columns) for name in group}  # fmt: skip
    return {
        name: column.model_copy(update={"unit": units[column.source]})
        if column.unit == "1" and units.get(column.source) in allowed.get(name, lengths + angles)
        else column
        for name, column in sources.items()
    }


def _check_spelling(
    present: Iterable[str], sources: Mapping[str, Column], known: Sequence[str], file: Path | str
) -> None:
    used = {column.source for column in sources.values()}
    near = misspelt(unused([str(name) for name in present], used), set(known) - set(sources))
    if near is not None:
        raise TableError(
            f"{file}: column {near[0]!r} is not used; did you mean {near[1]!r}? Rename the column, or delete it",
            near[0],
        )


def numbers(
    values: list[object], column: Column, file: Path | str, rows: Sequence[int] | np.ndarray | None = None
) -> np.ndarray:
    """Column values as finite numbers in SI units. Raises InputError that names the row.

    rows: their numbers in the table, from 0; None: in order.
    """
    values_read = floats(pd.Series(values))
    number = np.abs(values_read) < _LARGEST
    bad = np.flatnonzero(~number | np.array([isinstance(value, bool) for value in values], dtype=bool))
    if len(bad):
        row, allowed = bad[0], "finite numbers"
        if np.isfinite(values_read[row]):
            allowed = f"finite numbers below {_LARGEST:g}"
        number = int(row if rows is None else rows[row])
        message = f"{file}: column {column.source!r}, row {number + 1}: found {values[row]!r}; allowed are {allowed}"
        if isinstance(values[row], str) and str(values[row]).strip().isalpha():
            message += ". A row that is no pose, such as a summary, must be deleted"
        raise TableError(message, column.source, number)
    return values_read * UNITS[column.unit]


def _check_groups(columns: Mapping[str, np.ndarray], file: Path | str, measured: bool) -> None:
    for group in _GROUPS:
        present = [c for c in group if c in columns]
        if present and len(present) < len(group):
            missing = ", ".join(c for c in group if c not in columns)
            raise TableError(f"{file}: it has {', '.join(present)}, but not {missing}; allowed is all of them or none")
    if measured and not any(c in columns for group in _GROUPS for c in group):
        raise TableError(f"{file}: nothing was measured; allowed are {_ALLOWED}")


def _check_rows(columns: dict[str, np.ndarray], file: Path | str) -> None:
    pose = columns["pose"]
    _refuse(pose != np.round(pose), file, "pose", pose, "whole numbers")
    columns["pose"] = pose = pose.astype(np.int64)
    first = np.unique(pose, return_index=True)[1]
    repeated = np.setdiff1d(np.arange(len(pose)), first)
    if len(repeated):
        row = repeated[0]
        raise TableError(f"{file}: pose {pose[row]} appears twice (row {row + 1}); allowed is once", "pose", int(row))
    for name, values in columns.items():
        if name.endswith("_std"):
            _refuse(~(values > 0), file, name, values, "numbers greater than 0")
    for channel in CHANNELS:
        wrong = channel.wrong_row(columns) if channel.columns[0] in columns else None
        if wrong is not None:
            raise TableError(f"{file}: row {wrong[0] + 1}: {wrong[1]}", row=wrong[0])


def _refuse(bad: np.ndarray, file: Path | str, column: str, values: np.ndarray, allowed: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise TableError(
            f"{file}: column {column!r}, row {row + 1}: found {values[row]:g}; allowed are {allowed}", column, row
        )


def check_readings(
    table: pd.DataFrame, chain: ClosedChain, actuators: Actuators, tolerance: Tolerance, file: Path | str
) -> None:
    """Refuse joint values beyond the URDF's limits (three tolerances of zero and gain are forgiven)."""
    for k, name in enumerate(chain.actuated_names):
        joint = chain.actuated[k]
        zero = tolerance.actuator_zero_mm * 1e-3 if chain.prismatic[joint] else np.deg2rad(tolerance.actuator_zero_deg)
        readings = table[name].to_numpy(float)
        values = actuators.zero[k] + actuators.gain[k] * readings
        slack = 3 * (zero + tolerance.actuator_gain * np.abs(actuators.gain[k] * readings))
        low, high = chain.lower[joint] - slack, chain.upper[joint] + slack
        bad = np.flatnonzero((values < low) | (values > high))
        if len(bad):
            row, unit = bad[0], "m" if chain.prismatic[joint] else "rad"
            smaller = next((u for u in ("mm", "deg") if low[row] <= values[row] * UNITS[u] <= high[row]), None)
            hint = f"; is it in {smaller}? (measure.columns gives a column's unit)" if smaller else ""
            message = (
                f"{file}: pose {table['pose'][row]}: joint {name!r} would be at {values[row]:.6g} {unit}; "
                f"its limits are [{chain.lower[joint]:.6g}, {chain.upper[joint]:.6g}]{hint}"
            )
            raise TableError(message, name, int(row))
