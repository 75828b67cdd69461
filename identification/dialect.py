"""How a text table was written: encoding, separator, decimal sign, where its header is, a row of units.

Recorders and spreadsheets write tables in many ways. What is not set in [measure] is recognised from the head of the
file: the header is the row with most names that a measurement table can have.
"""

from __future__ import annotations

import codecs
import csv
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kincal.urdf.description import Measure, listed
from kincal.urdf.errors import InputError, quoted

SEPARATORS = (",", ";", "\t", "|", " ")
_HEAD = 1 << 16  # bytes that are looked at
_LINES = 200  # of them, for the header and the first rows
_ENOUGH = 2  # names that make a header
_BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_COMMENT = re.compile(r"\s*(#|%|//)\s*")
_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")
_UNITS = {"m": "m", "mm": "mm", "cm": "cm", "in": "in", "inch": "in", "rad": "rad", "deg": "deg", "°": "deg"}
_UNITS |= {"degree": "deg", "degrees": "deg", "meter": "m", "metre": "m", "radian": "rad", "rev": "rev"}
_NO_UNIT = {"", "-", "1", "s", "#", "none"}


@dataclass(frozen=True)
class Dialect:
    """Of one file."""

    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]  # of the columns
    skipped: tuple[int, ...]  # lines that are no data: what stands above the header, the header, a row of units
    units: dict[str, str]  # {column: unit} by a row of units
    block: str  # what the file is, if its columns are named by several lines
    trailing: bool  # whether rows end with a separator that the header has not got
    notes: tuple[str, ...] = ()


def recognised(file: Path, measure: Measure, wanted: Iterable[str] = ()) -> Dialect:
    """The dialect of a text table. wanted: names that its header may have. Raises InputError."""
    with open(file, "rb") as stream:
        head = stream.read(_HEAD)
    encoding = encoding_of(file, measure, head)
    lines = _lines(head, encoding)
    names = {folded(name) for name in (*wanted, *(column.source for column in measure.columns.values()))}
    row, separator, score = _header(lines, measure, names)
    if row is None:
        return Dialect(encoding, separator, measure.decimal or ".", (), (), {}, "", False)
    columns = tuple(cell.strip() for cell in _cells(_COMMENT.sub("", lines[row], count=1), separator))
    rows = [(k, _cells(line, separator)) for k, line in enumerate(lines[row + 1 :], row + 1) if line.strip()]
    units = _units(columns, rows[0][1]) if rows else {}
    skipped = [*range(row + 1), *([rows[0][0]] if units else [])]
    data = [cells for _, cells in rows[bool(units) :]]
    trailing = bool(data) and all(len(c) == len(columns) + 1 and not c[-1].strip() for c in data)
    decimal = measure.decimal or _decimal(data)
    found = Dialect(encoding, separator, decimal, columns, tuple(skipped), units, _block(lines, columns), trailing)
    return Dialect(**{**vars(found), "notes": tuple(_notes(file, measure, found, row))}) if score else found


def encoding_of(file: Path, measure: Measure, head: bytes) -> str:
    """As set, else by the first bytes. Raises InputError."""
    encoding = measure.encoding or _encoding(head)
    try:
        codecs.lookup(encoding)
    except LookupError:
        raise InputError(
            f"{file}: measure.encoding: {quoted(encoding)} is unknown; allowed are utf-8, utf-16, cp1252 and others of "
            "Python"
        ) from None
    return encoding


def folded(name: str) -> str:
    """A name without blanks around it and without capitals."""
    return unicodedata.normalize("NFKC", name).strip().strip('"').casefold()


def units_of(columns: Sequence[str], cells: Sequence[object]) -> dict[str, str]:
    """{column: unit} where a row names units; empty where it does not."""
    return _units(columns, ["" if cell is None else str(cell) for cell in cells])


def header_of(rows: Sequence[Sequence[object]], names: set[str]) -> int | None:
    """The row with most of the names; None where no row has enough."""
    scores = [len({folded(str(cell)) for cell in row} & names) for row in rows]
    best = max(scores, default=0)
    return scores.index(best) if best >= _ENOUGH else None


def _block(lines: Sequence[str], columns: Sequence[str]) -> str:
    """What an export is whose columns have names on several lines; empty for a table."""
    if (
        lines
        and lines[0].startswith("Format Version,")
        and any("Rigid Body" in line or "Marker" in line for line in lines)
    ):
        return "a Motive export: its columns are named by several lines, and it has no joint values"
    repeated = sorted({name for name in columns if name and columns.count(name) > 1})
    if len(repeated) > 1:
        return f"columns {listed(repeated)} appear several times: a header of several lines"
    return ""


def _encoding(head: bytes) -> str:
    for bom, name in _BOMS:
        if head.startswith(bom):
            return name
    if head[1:200:2].count(0) > len(head[1:200:2]) / 2:
        return "utf-16-le"
    try:
        head[: -4 if len(head) == _HEAD else None].decode()
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _lines(head: bytes, encoding: str) -> list[str]:
    lines = head.decode(encoding, errors="replace").splitlines()
    return (lines[:-1] if len(head) == _HEAD else lines)[:_LINES]


def _header(lines: Sequence[str], measure: Measure, names: set[str]) -> tuple[int | None, str, int]:
    """The header's line, the separator, and how many of the names the line has."""
    separators = SEPARATORS if measure.separator is None else (measure.separator,)
    if measure.header_row is not None:
        candidates = [measure.header_row - 1] if measure.header_row <= len(lines) else []
    else:
        candidates = [k for k, line in enumerate(lines) if line.strip()]
    best: tuple[int, int, int] | None = None  # names, minus the line, minus the separator
    for k in candidates:
        plain = _COMMENT.sub("", lines[k], count=1)
        for s, separator in enumerate(separators):
            cells = _cells(plain, separator)
            score = len({folded(cell) for cell in cells} & names)
            if separator == " " != measure.separator and score and not _go_on(lines, k, separator, len(cells)):
                continue  # blanks inside of names
            best = max(best or (score, -k, -s), (score, -k, -s))
    if best is None:
        return None, separators[0], 0
    if best[0] >= _ENOUGH or measure.header_row is not None:
        return -best[1], separators[-best[2]], best[0]
    # no row has the names: the first one that is no comment, as it may be
    first = next((k for k in candidates if not _COMMENT.match(lines[k])), candidates[0])
    counts = [len(_cells(lines[first], separator)) for separator in separators]
    counts = [n * (1 + _go_on(lines, first, s, n) * len(lines[first])) for s, n in zip(separators, counts, strict=True)]
    return first, separators[counts.index(max(counts))], best[0] if best[0] else 0


def _go_on(lines: Sequence[str], k: int, separator: str, n: int) -> bool:
    """Whether one of the next two lines has as many cells as line k, n: with the right separator it does."""
    below = [line for line in lines[k + 1 :] if line.strip()][:2]
    return n > 1 and (not below or any(len(_cells(line, separator)) in (n, n + 1) for line in below))


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []


def _units(columns: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    plain = [cell.strip().strip("[]()").strip().casefold() for cell in cells]
    known = [cell in _UNITS for cell in plain]
    if len(plain) > len(columns) + 1 or not any(known) or not all(c in _UNITS or c in _NO_UNIT for c in plain):
        return {}
    return {column: _UNITS[cell] for column, cell in zip(columns, plain, strict=False) if cell in _UNITS}


def _decimal(rows: Sequence[Sequence[str]]) -> str:
    cells = [cell.strip() for row in rows for cell in row]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    return "," if commas and not any(_POINT.fullmatch(cell) for cell in cells) else "."


def _notes(file: Path, measure: Measure, found: Dialect, row: int) -> Iterator[str]:
    """What was recognised and is not usual, with the key that sets it."""
    parts = []
    if measure.encoding is None and found.encoding not in ("utf-8", "utf-8-sig"):
        parts.append(f'measure.encoding = "{found.encoding}"')
    if measure.separator is None and found.separator != ",":
        shown = found.separator.replace("\t", "\\t")
        parts.append(f'measure.separator = "{shown}"')
    if measure.decimal is None and found.decimal != ".":
        parts.append(f'measure.decimal = "{found.decimal}"')
    if measure.header_row is None and row > 0:
        parts.append(f"measure.header_row = {row + 1}")
    if found.units:
        units = listed(f"{name} in {unit}" for name, unit in found.units.items())
        parts.append(f"a row of units ({units})")
    if found.trailing:
        parts.append("a separator at the end of each row")
    if parts:
        yield f"{file}: recognised {', '.join(parts)}"
