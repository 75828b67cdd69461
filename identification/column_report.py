"""What kincal recognises in a measurement table: how it is written, and what each column is taken for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import CHANNELS
from kincal.identification.column_proposals import proposals
from kincal.identification.dialect import recognised
from kincal.identification.measurement_table import known_columns, used_columns
from kincal.identification.table_files import TABLE_NAMES, floats, is_blank, load
from kincal.identification.workbooks import WORKBOOKS
from kincal.urdf.description import EULER_ANGLES, Column, Measure

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", " ": "blanks", "|": "bar"}
_OF_FRAMES = {"frame": ("frame of the export", ""), "t": ("time", "s")}


@dataclass(frozen=True)
class ColumnReport:
    """One column of the file."""

    name: str
    canonical: str  # the name that kincal has for it; empty: not used
    meaning: str
    unit: str
    low: float | None  # in the file's own unit; None: no numbers
    high: float | None
    blank: int  # cells
    proposed: str = ""  # a name that it may have, where it is not used


@dataclass(frozen=True)
class TableReport:
    """A file: facts about it, its columns, and the column map that reads it."""

    file: Path
    rows: int
    facts: tuple[tuple[str, str], ...]
    columns: tuple[ColumnReport, ...]
    column_map: dict[str, Column]  # with the proposals
    missing: tuple[str, ...]  # joints that no column has

    @property
    def is_export(self) -> bool:
        """Whether it is one of motion capture, which has no joints."""
        return any(key == "export" for key, _ in self.facts)


def table_report(file: Path, measure: Measure, joints: Sequence[str]) -> TableReport:
    """What is recognised in a table under these settings. joints: of the robot; empty: unknown. Raises InputError."""
    known = known_columns(joints, measure)
    raw = load(file, measure, known)
    used = used_columns(raw, joints, measure)
    taken = {column.source: name for name, column in used.items()}
    free = [str(name) for name in raw.columns if name not in taken]
    free = [] if "export" in raw.attrs else free
    guessed = proposals(free, [name for name in known if name not in used])
    likely = {column.source: (name, column.unit) for name, column in guessed.items()}
    columns = tuple(_column(raw, str(name), taken, used, likely, joints) for name in raw.columns)
    missing = tuple(joint for joint in joints if joint not in used and joint not in guessed)
    return TableReport(file, len(raw), _facts(file, measure, known, raw), columns, {**used, **guessed}, missing)


def _column(
    raw: pd.DataFrame,
    name: str,
    taken: dict[str, str],
    used: dict[str, Column],
    likely: dict[str, tuple[str, str]],
    joints: Sequence[str],
) -> ColumnReport:
    values = raw[name]
    numbers = floats(values)
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
    blank = int(is_blank(values).sum())
    canonical = taken.get(name, "")
    if canonical:
        unit = used[canonical].unit
        meaning, usual = _meaning(canonical, joints)
        return ColumnReport(name, canonical, meaning, usual if unit == "1" else unit, low, high, blank)
    if "export" in raw.attrs and name in _OF_FRAMES:
        return ColumnReport(name, "", *_OF_FRAMES[name], low, high, blank)
    proposed, unit = likely.get(name, ("", ""))
    return ColumnReport(name, "", "not used", "" if unit == "1" else unit, low, high, blank, proposed)


def _meaning(canonical: str, joints: Sequence[str]) -> tuple[str, str]:
    """What a canonical column holds, and its unit."""
    if canonical in joints:
        return "joint", ""
    for channel in CHANNELS:
        if canonical == f"{channel.name}_std":
            return f"standard deviation of {channel.name}", channel.unit
        if canonical in channel.columns:
            return channel.name, channel.column_unit.replace("1", "")
        if any(canonical in group for group in channel.other_columns):
            return channel.name, channel.unit
    return ("orientation", "rad") if canonical in EULER_ANGLES else ("number of the pose", "")


def _facts(file: Path, measure: Measure, known: Sequence[str], raw: pd.DataFrame) -> tuple[tuple[str, str], ...]:
    if "export" in raw.attrs:
        return (
            ("format", f"{raw.attrs['export']} export"),
            *(("export", n.partition(": ")[2]) for n in raw.attrs["notes"]),
        )
    suffix = file.suffix.lower()
    if suffix in (".parquet", ".pq"):
        return (("format", "Parquet"),)
    if suffix in WORKBOOKS:
        return (("format", "workbook"), *(("sheet", note.partition(": ")[2]) for note in raw.attrs["notes"]))
    dialect = recognised(file, measure, (*known, *TABLE_NAMES))
    header = len(dialect.skipped) - bool(dialect.units)
    above = f", {header - 1} lines above are not read" if header > 1 else ""
    facts = [
        ("format", "text"),
        ("encoding", dialect.encoding),
        ("separator", _SEPARATORS.get(dialect.separator, dialect.separator)),
        ("decimal sign", dialect.decimal),
        ("names in line", f"{header}{above}"),
    ]
    facts += [("units in line", str(dialect.skipped[-1] + 1))] if dialect.units else []
    facts += [("rows end with", "a separator")] if dialect.trailing else []
    return tuple(facts)
