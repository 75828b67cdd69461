"""Streams in CSV and Parquet, in chunks."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import pandas as pd

from kincal.identification.dialect import recognised
from kincal.identification.streams.columns import OPTIONAL, REQUIRED, Rows, mapped
from kincal.identification.streams.health import Tally
from kincal.identification.streams.topics import Topics
from kincal.identification.table_files import TABLE_NAMES, decoded, header, parquet, readable
from kincal.urdf.description import Measure
from kincal.urdf.input_files import bounded_each, check_records

ROWS = 50_000  # a chunk
_LONGEST = 1 << 16  # bytes of a line: beyond it is garbage


def logged(file: Path, measure: Measure, form: str, by_pose: bool, tally: Tally) -> Iterator[pd.DataFrame]:
    """Chunks of a stream: blank cells are NaN, other cells without a number infinite. Lines with too few or too many
    fields are counted as garbage. Rows that are blank in roll and pitch hold no sample.

    by_pose: it must have a pose column. Raises InputError for a missing column.
    """
    topics = Topics(tally, separate=False if by_pose else None)
    with readable(file):
        rows = _parquet(file, measure, by_pose, tally) if form == "parquet" else _text(file, measure, by_pose, tally)
        for chunk in rows:
            yield topics.feed(chunk)
    topics.rest()


def _text(file: Path, measure: Measure, by_pose: bool, tally: Tally) -> Iterator[pd.DataFrame]:
    measure = _written(file, measure)
    names = header(file, measure)
    columns = mapped(names, measure, file, by_pose)
    rows, sources = Rows(file, columns), [c.source for c in columns.values()]
    for raw in _csv(file, measure, names, sources, tally):
        yield rows.values(raw)


def has_pose(file: Path, measure: Measure, form: str) -> bool:
    """Whether a table of samples says which pose each is of."""
    if form == "parquet":
        with parquet(file) as (_, names):
            pass
    else:
        names = header(file, _written(file, measure))
    column = measure.columns.get("pose")
    return "pose" in names or (column is not None and column.source in names)


def _parquet(file: Path, measure: Measure, by_pose: bool, tally: Tally) -> Iterator[pd.DataFrame]:
    with parquet(file) as (table, names):
        columns = mapped(names, measure, file, by_pose)
        rows, sources = Rows(file, columns), list(dict.fromkeys(c.source for c in columns.values()))
        count = table.metadata.num_rows
        check_records(file, count, count * len(sources) if by_pose else 0)
        batches = table.iter_batches(batch_size=ROWS, columns=sources, use_threads=False)
        for raw in bounded_each(file, (decoded(file, batch) for batch in batches)):
            tally.read += len(raw)
            yield rows.values(raw)


def _csv(file: Path, measure: Measure, names: list[str], wanted: list[str], tally: Tally) -> Iterator[pd.DataFrame]:
    separator = (measure.separator or ",").encode()
    with open(file, "rb") as stream:
        stream.readline()
        while block := list(islice(_lines(stream), ROWS)):
            good = [line for line in block if _whole(line, separator, len(names))]
            tally.read, tally.garbage = tally.read + len(block), tally.garbage + len(block) - len(good)
            if good:
                chunk = pd.read_csv(
                    BytesIO(b"\n".join(good)),
                    header=None,
                    names=names,
                    usecols=wanted,
                    sep=measure.separator or ",",
                    decimal=measure.decimal or ".",
                    skipinitialspace=True,
                    encoding_errors="replace",
                    low_memory=False,
                )
                yield _with_points(chunk) if measure.decimal == "," else chunk


def _written(file: Path, measure: Measure) -> Measure:
    """With the separator and the decimal sign that are recognised where they are not set."""
    if measure.separator is not None and measure.decimal is not None:
        return measure
    dialect = recognised(file, measure, (*REQUIRED, *OPTIONAL, *TABLE_NAMES))
    return measure.model_copy(update={"separator": dialect.separator, "decimal": dialect.decimal})


def _with_points(table: pd.DataFrame) -> pd.DataFrame:
    """Columns that one cell made text, with decimal points: only pandas' parser of whole columns knows commas."""
    text = [str(name) for name in table if not pd.api.types.is_numeric_dtype(table[name])]
    return table.assign(**{name: table[name].str.replace(",", ".", regex=False) for name in text})


def _lines(stream: BinaryIO) -> Iterator[bytes]:
    while line := stream.readline(_LONGEST):
        line = line.rstrip(b"\r\n")
        if line:
            yield line


def _whole(line: bytes, separator: bytes, fields: int) -> bool:
    """Whether a line has as many fields as the header, and nothing that would spill into the next."""
    if b'"' in line:
        if line.count(b'"') % 2:
            return False
        cells = next(csv.reader([line.decode(errors="replace").replace("\0", "")], delimiter=separator.decode()))
        return len(cells) == fields and b"\0" not in line and b"\r" not in line
    count = len(line.split()) if separator == b" " else line.count(separator) + 1
    return count == fields and b"\0" not in line and b"\r" not in line
