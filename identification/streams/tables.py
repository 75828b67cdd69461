"""Streams in CSV and Parquet, in chunks.

A file with a `pose` column was prepared by somebody: every value must be right, as in a measurement table. One without
is a log: what is wrong is counted and left out.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from identification.measurements import header, readable
from identification.streams.columns import leniently, mapped, strictly
from identification.streams.health import Tally
from urdf.description import Measure
from urdf.errors import InputError

ROWS = 50_000  # a chunk
_LONGEST = 1 << 16  # bytes of a line: beyond it is garbage


def prepared(file: Path, measure: Measure, form: str) -> Iterator[pd.DataFrame]:
    """Chunks of a stream with a pose column. InputError for values that are no numbers and time that runs backwards."""
    first, last = 0, -np.inf
    with readable(file):
        names = _names(file, measure, form)
        columns = mapped(names, measure, file, prepared=True)
        sources = [c.source for c in columns.values()]
        for raw in _parquet(file, sources) if form == "parquet" else _whole_csv(file, measure):
            chunk = strictly(raw, columns, file, first)
            t = np.concatenate([[last], chunk["t"]])
            backwards = np.flatnonzero(np.diff(t) < 0)
            if len(backwards):
                k = backwards[0]
                raise InputError(
                    f"{file}: column 't', row {first + k + 1}: time runs backwards, from {t[k]:g} to {t[k + 1]:g} s"
                )
            first, last = first + len(chunk), t[-1]
            yield chunk
    if not first:
        yield pd.DataFrame({name: np.zeros(0) for name in columns})


def logged(file: Path, measure: Measure, form: str, tally: Tally) -> Iterator[pd.DataFrame]:
    """Chunks of a log; what is no number is NaN, and lines with too few or too many fields are counted as garbage."""
    with readable(file):
        names = _names(file, measure, form)
        columns = mapped(names, measure, file, prepared=False)
        sources = [c.source for c in columns.values()]
        for raw in _parquet(file, sources) if form == "parquet" else _csv(file, measure, names, sources, tally):
            if form == "parquet":
                tally.read += len(raw)
            yield leniently(raw, columns)


def _names(file: Path, measure: Measure, form: str) -> list[str]:
    if form == "parquet":
        import pyarrow.parquet as pq

        return pq.read_schema(file).names
    return [str(name) for name in header(file, measure)]


def has_pose(file: Path, measure: Measure, form: str) -> bool:
    """Whether a table of samples says which pose each is of."""
    with readable(file):
        names = _names(file, measure, form)
    column = measure.columns.get("pose")
    return "pose" in names or (column is not None and column.source in names)


def _parquet(file: Path, columns: list[str]) -> Iterator[pd.DataFrame]:
    import pyarrow.parquet as pq

    # by default it reads ahead: as much memory as the file has bytes
    with pq.ParquetFile(file, buffer_size=1 << 20, pre_buffer=False) as table:
        for batch in table.iter_batches(batch_size=ROWS, columns=columns, use_threads=False):
            yield batch.to_pandas()


def _whole_csv(file: Path, measure: Measure) -> Iterator[pd.DataFrame]:
    options: dict[str, Any] = {"sep": measure.separator, "decimal": measure.decimal, "skipinitialspace": True}
    chunks: Any = pd.read_csv(file, chunksize=ROWS, **options)
    with chunks:
        yield from chunks


def _csv(file: Path, measure: Measure, names: list[str], wanted: list[str], tally: Tally) -> Iterator[pd.DataFrame]:
    separator = measure.separator.encode()
    with open(file, "rb") as stream:
        stream.readline()
        while block := list(islice(_lines(stream), ROWS)):
            good = [line for line in block if _whole(line, separator, len(names))]
            tally.read, tally.garbage = tally.read + len(block), tally.garbage + len(block) - len(good)
            if good:
                yield pd.read_csv(
                    BytesIO(b"\n".join(good)),
                    header=None,
                    names=names,
                    usecols=wanted,
                    sep=measure.separator,
                    decimal=measure.decimal,
                    skipinitialspace=True,
                    encoding_errors="replace",
                    low_memory=False,
                )


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
        found = next(csv.reader([line.decode(errors="replace").replace("\0", "")], delimiter=separator.decode()))
        return len(found) == fields and b"\0" not in line and b"\r" not in line
    return line.count(separator) == fields - 1 and b"\0" not in line and b"\r" not in line
