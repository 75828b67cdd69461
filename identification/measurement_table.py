"""The measurement table: reading, checking, units. One row a static pose."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import CHANNELS
from kincal.identification.channels.orientation import quaternions as quaternions
from kincal.identification.column_names import check_units, matched, misspelt, unused, unused_note
from kincal.identification.joint_table import with_joints
from kincal.identification.orientations import as_quaternion, check_notation, shadowed
from kincal.identification.skipped_poses import kept, skip_note
from kincal.identification.table_files import floats, is_blank, load
from kincal.urdf.description import EULER_ANGLES, Column, Measure, listed, nearest
from kincal.urdf.errors import InputError, TableError, quoted

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "1": 1.0}
UNITS |= {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LENGTHS, ANGLES = ("m", "mm", "cm", "in"), ("rad", "deg", "rev")
_GROUPS = (*(group for c in CHANNELS for group in (c.columns, *c.other_columns)), EULER_ANGLES)
_LARGEST = 1e15  # a number beyond is no reading; below, whole numbers are exact and squares don't overflow
_ALLOWED = "; ".join(", ".join(group) for group in _GROUPS) + " (with measure.euler)"


def read_table(file: Path, joints: Sequence[str], measure: Measure, measured: bool = True) -> pd.DataFrame:
    """A file as the canonical table; see `canonical_table`."""
    return noted_table(file, joints, measure, measured)[0]


def noted_table(
    file: Path, joints: Sequence[str], measure: Measure, measured: bool = True
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A file as the canonical table, and notes on what was not used."""
    raw = load(file, measure, known_columns(joints, measure))
    if measured:
        return measured_poses(raw, joints, measure, file)
    return canonical_table(raw, joints, measure, file, measured), table_notes(raw, joints, measure, file)


def measured_poses(
    raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """The table that [measure] describes as the canonical one, and notes on it. Raises InputError."""
    raw = _joined(raw, joints, measure, file)
    table = canonical_table(raw, joints, measure, file)
    check_notation(table.columns, raw.columns, measure, file)
    return table, table_notes(raw, joints, measure, file)


def _joined(raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str) -> pd.DataFrame:
    """With the joint values of measure.joints, where the table has none."""
    if measure.joints is None:
        return raw
    columns = _sources(raw.columns, joints, measure)
    if any(name in columns for name in joints):
        note = f"{file}: the joint values are those of this table; measure.joints is not used"
        raw.attrs["notes"] = (*raw.attrs.get("notes", ()), note)
        return raw
    sources = {name: measure.columns[name].source for name in joints if name in measure.columns}
    return with_joints(raw, [sources.get(name, name) for name in joints], measure, file)


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
    known = known_columns(joints, measure)
    wrong = next((name for name in measure.columns if name not in known), None)
    if wrong is not None:
        where = f"{file}: measure.columns: {quoted(wrong)}"
        raise InputError(f"{where} is no column of a measurement table; {nearest(wrong, known)}")
    stay = _kept(raw, joints, measure, file)
    seen = stay & ~_unmeasured(raw, joints, measure) if measured else stay
    rows = np.flatnonzero(seen if seen.any() else stay)
    sources = used_columns(raw, joints, measure)
    check_units(sources, _GROUPS, file)
    columns = {"pose": rows, **_values(raw, sources, joints, measure, file, rows)}
    if measured:
        _check_spelling(raw.columns, sources, known, file)
    _check_groups(columns, file, measured)
    columns = as_quaternion(columns, measure, file, rows)
    _check_rows(columns, file, rows)
    for channel in CHANNELS:
        columns = channel.canonical(columns)
    return pd.DataFrame(columns)


def _values(
    raw: pd.DataFrame,
    sources: Mapping[str, Column],
    joints: Sequence[str],
    measure: Measure,
    file: Path | str,
    rows: np.ndarray,
) -> dict[str, np.ndarray]:
    """{canonical name: (n,) numbers of these rows}. Raises TableError for a missing column."""
    columns = {}
    for name in known_columns(joints, measure):
        if name in sources:
            columns[name] = numbers(raw[sources[name].source].iloc[rows].tolist(), sources[name], file, rows)
        elif name in measure.columns or name in joints:
            _check_export(raw.attrs, joints, file)
            source = measure.columns[name].source if name in measure.columns else name
            raise TableError(
                f"{file}: column {quoted(source)} ({name}) is missing; it has {listed(raw.columns)}", source
            )
    return columns


def _check_export(attributes: Mapping[Hashable, object], joints: Sequence[str], file: Path | str) -> None:
    """Refuse an export without joint values, with the way to give them."""
    if "export" in attributes and joints:
        raise TableError(
            f"{file}: a {attributes['export']} export: its columns are named by several lines, and it has no joint "
            f"values. Set measure.joints to a table of {listed(['pose', *joints])}, and frame (or frame_from and "
            "frame_to, or t_from and t_to). Or make one table with a single line of names: pose, the joints, and x, y, "
            "z, qx, qy, qz, qw",
            joints[0],
        )


def _kept(raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str) -> np.ndarray:
    """(n,) rows that measure.skip does not leave out. What else they hold is not read."""
    if not measure.skip:
        return np.ones(len(raw), dtype=bool)
    column = _sources(raw.columns, joints, measure).get("pose")
    poses = np.arange(len(raw), dtype=float) if column is None else floats(raw[column.source])
    return kept(poses, measure.skip, file)


def _unmeasured(raw: pd.DataFrame, joints: Sequence[str], measure: Measure) -> np.ndarray:
    """(n,) rows that have joint values, and nothing in any measured column: the target was not seen there."""
    sources = _sources(raw.columns, joints, measure)
    seen = [column.source for name, column in sources.items() if name not in ("pose", *joints)]
    if not seen:
        return np.zeros(len(raw), dtype=bool)
    return np.all([is_blank(raw[name]) for name in seen], axis=0)


def table_notes(raw: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str) -> tuple[str, ...]:
    """What a user should know of the columns: those that nothing uses, named once."""
    used = {column.source for column in _sources(raw.columns, joints, measure).values()}
    blank = np.flatnonzero(_kept(raw, joints, measure, file) & _unmeasured(raw, joints, measure))
    skipped = f"{file}: {len(blank)} of {len(raw)} rows have no measurement and are skipped: rows {listed(blank + 1)}"
    others = [name for name in unused(list(raw.columns), used) if not name.startswith("planned_")]  # of `kincal plan`
    notes = [*raw.attrs.get("notes", ()), *([skipped] if 0 < len(blank) < len(raw) else [])]
    notes += [skip_note(measure.skip, file)] if measure.skip else []
    return (*notes, *([f"{file}: {unused_note(others)}"] if others else []))


def known_columns(joints: Sequence[str], measure: Measure) -> list[str]:
    """The canonical columns that a table may have under these settings."""
    measured = [name for group in (_GROUPS if measure.euler else _GROUPS[:-1]) for name in group]
    return ["pose", *joints, *measured, *(f"{c.name}_std" for c in CHANNELS)]


def used_columns(raw: pd.DataFrame, joints: Sequence[str], measure: Measure) -> dict[str, Column]:
    """{canonical name: the column that it is read from, and its unit}."""
    return _with_units(_sources(raw.columns, joints, measure), raw.attrs.get("units", {}))


def _sources(present: Iterable[str], joints: Sequence[str], measure: Measure) -> dict[str, Column]:
    """{canonical name: the column that has it, and its unit}."""
    names, sources = [str(name) for name in present], {}
    known = known_columns(joints, measure)
    plain = matched(names, known)
    mapped = matched(names, [column.source for column in measure.columns.values()])
    for name in known:
        column = measure.columns.get(name)
        if column is not None and column.source in mapped:
            sources[name] = column.model_copy(update={"source": mapped[column.source]})
        elif name in plain:  # a canonical table needs no map
            sources[name] = Column.model_validate({"from": plain[name]})
    hidden = shadowed(sources, measure)
    return {name: column for name, column in sources.items() if name not in hidden}


def _with_units(sources: Mapping[str, Column], units: Mapping[str, str]) -> dict[str, Column]:
    """Units of a row of units, where the column map names none; degrees and lengths of what is measured alone."""
    of_kind = {"m": LENGTHS, "rad": ANGLES, "1": ()}
    allowed = {name: of_kind[c.column_unit] for c in CHANNELS for name in c.columns}
    allowed |= {name: of_kind[c.unit] for c in CHANNELS for group in c.other_columns for name in group}
    allowed |= dict.fromkeys(EULER_ANGLES, ANGLES)
    return {
        name: column.model_copy(update={"unit": units[column.source]})
        if column.unit == "1" and units.get(column.source) in allowed.get(name, LENGTHS + ANGLES)
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
            f"{file}: column {quoted(near[0])} is not used; did you mean {quoted(near[1])}? "
            "Rename the column, or delete it",
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
        place = f"{file}: column {quoted(column.source)}, row {number + 1}"
        message = f"{place}: found {quoted(values[row])}; allowed are {allowed}"
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


def _check_rows(columns: dict[str, np.ndarray], file: Path | str, rows: np.ndarray) -> None:
    """rows: (n,) their numbers in the file, from 0."""
    pose = columns["pose"]
    _refuse(pose != np.round(pose), file, "pose", pose, "whole numbers", rows)
    columns["pose"] = pose = pose.astype(np.int64)
    first = np.unique(pose, return_index=True)[1]
    repeated = np.setdiff1d(np.arange(len(pose)), first)
    if len(repeated):
        at, row = repeated[0], int(rows[repeated[0]])
        raise TableError(f"{file}: pose {pose[at]} appears twice (row {row + 1}); allowed is once", "pose", row)
    for name, values in columns.items():
        if name.endswith("_std"):
            _refuse(~(values > 0), file, name, values, "numbers greater than 0", rows)
    for channel in CHANNELS:
        wrong = channel.wrong_row(columns) if channel.columns[0] in columns else None
        if wrong is not None:
            row = int(rows[wrong[0]])
            raise TableError(f"{file}: row {row + 1}: {wrong[1]}", row=row)


def _refuse(bad: np.ndarray, file: Path | str, column: str, values: np.ndarray, allowed: str, rows: np.ndarray) -> None:
    if bad.any():
        at = int(np.argmax(bad))
        row = int(rows[at])
        raise TableError(
            f"{file}: column {quoted(column)}, row {row + 1}: found {values[at]:g}; allowed are {allowed}", column, row
        )
