"""CSV and Parquet files as they are, within limits that are checked before anything is unpacked."""

from __future__ import annotations

import codecs
import csv
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pandas as pd

from kincal.identification.channels import CHANNELS
from kincal.identification.dialect import encoding_of, recognised
from kincal.identification.table_formats import format_of
from kincal.identification.table_formats.export import HEAD, Source
from kincal.identification.workbook_size import check_workbook
from kincal.identification.workbooks import WORKBOOKS, workbook
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError, quoted, shortened
from kincal.urdf.input_files import MAX_UNPACKED, bounded, check_file, unreadable

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

MAX_BYTES = 256 << 20  # of a table's file; streams, which are read piece by piece, may be longer
MAX_LINE = 1 << 20  # bytes of a line of CSV
MAX_COLUMNS = 2_000
MAX_ROWS = 4_000_000
MAX_CELLS = 32_000_000
TABLE_NAMES = ("pose", "t", *(name for c in CHANNELS for group in (c.columns, *c.other_columns) for name in group))
_TRAILING = "trailing separator"  # a name for what stands behind it: nothing
_PACKED = (b"\x1f\x8b", b"PK\x03\x04", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd")  # gzip, zip, bzip2, xz, zstd


def load(file: Path, measure: Measure, wanted: Sequence[str] = ()) -> pd.DataFrame:
    """A text table, a Parquet file (without nested columns) or a workbook.

    wanted: names that its columns may have. What was recognised stands in the table's `attrs`: `notes`, and `units` of
    columns by a row of units.
    """
    check_file(file, MAX_BYTES)
    names = (*wanted, *TABLE_NAMES)
    with readable(file):
        if file.suffix.lower() in (".parquet", ".pq"):
            return _parquet(file)
        if file.suffix.lower() in WORKBOOKS:
            check_workbook(file)
            return workbook(file, measure, names)
        return _text(file, measure, names)


def _text(file: Path, measure: Measure, wanted: Sequence[str]) -> pd.DataFrame:
    with open(file, "rb") as stream:
        if stream.read(8).startswith(_PACKED):
            raise InputError(f"{file}: it is compressed; unpack it first")
        stream.seek(0)
        encoding = encoding_of(file, measure, stream.read(1 << 16))
        stream.seek(0)
        rows = sum(1 for _ in _lines(file, stream))
    with open(file, encoding=encoding, errors="replace") as text:
        source = Source(file, tuple(line.rstrip("\r\n") for line in islice(text, HEAD)), encoding)
    form = format_of(source.lines)
    if form is not None:
        _check_size(file, rows, max(line.count(",") + line.count("\t") for line in source.lines))
        return form.read(source, measure)
    dialect = recognised(file, measure, wanted)
    if dialect.block:
        raise InputError(
            f"{file}: {dialect.block}. Make a table with one line of names: pose, one column a joint, and x, y, z, qx, "
            "qy, qz, qw"
        )
    if not any(dialect.names):
        raise InputError(f"{file}: the file is empty; a header and at least one row are needed")
    check_names(file, dialect.names)
    _check_size(file, rows, len(dialect.names))
    names = [*dialect.names, *([_TRAILING] if dialect.trailing else [])]
    options: dict[str, Any] = {
        "sep": r"\s+" if dialect.separator == " " else dialect.separator,
        "decimal": dialect.decimal,
        "encoding": dialect.encoding,
        "comment": measure.comment,
        "skiprows": list(dialect.skipped),
        "names": names,
        "usecols": list(range(len(dialect.names))) if dialect.trailing else None,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        # else a row that is longer than the header makes its first columns an index: all others move
        table = pd.read_csv(file, compression=None, index_col=False, header=None, skipinitialspace=True, **options)
    table.attrs.update(notes=dialect.notes, units=dialect.units)
    return table


def header(file: Path, measure: Measure) -> list[str]:
    """The column names of a CSV file. Raises InputError where one appears twice, and for too many."""
    with readable(file), open(file, "rb") as stream:
        if stream.read(8).startswith(_PACKED):
            raise InputError(f"{file}: it is compressed; unpack it first")
        stream.seek(0)
        rows = csv.reader(_texts(file, stream), delimiter=measure.separator or ",", skipinitialspace=True)
        names = next((row for row in rows if any(cell.strip() for cell in row)), [])
    if not names:
        raise InputError(f"{file}: the file is empty; a header and at least one row are needed")
    check_names(file, names)
    return names


def check_names(file: Path | str, names: Sequence[str]) -> None:
    if len(names) > MAX_COLUMNS:
        raise InputError(f"{file}: {len(names)} columns; allowed are {MAX_COLUMNS}")
    repeated = next((name for name, n in Counter(names).items() if n > 1), None)
    if repeated is not None:
        raise InputError(f"{file}: column {quoted(repeated)} appears twice; allowed is once")


def _texts(file: Path, stream: BinaryIO) -> Iterator[str]:
    """The lines of a stream at its begin; a byte order mark is no part of them."""
    for k, line in enumerate(_lines(file, stream)):
        for part in (line if k else line.removeprefix(codecs.BOM_UTF8)).splitlines(keepends=True):
            yield part.decode()


def _lines(file: Path, stream: BinaryIO) -> Iterator[bytes]:
    """Raises InputError for one that is too long."""
    while line := stream.readline(MAX_LINE + 1):
        if len(line) > MAX_LINE:
            raise InputError(f"{file}: a line is longer than {MAX_LINE} bytes, which are allowed")
        yield line


def _check_size(file: Path, rows: int, columns: int) -> None:
    if rows > MAX_ROWS or rows * columns > MAX_CELLS:
        raise InputError(f"{file}: {rows} rows of {columns} columns; allowed are {MAX_ROWS} rows and {MAX_CELLS} cells")


def floats(values: pd.Series) -> np.ndarray:
    """(n,) a column's numbers; NaN for what is none."""
    try:
        return np.array(pd.to_numeric(values, errors="coerce"), dtype=float)
    except OverflowError:  # a whole number of hundreds of digits
        return np.array([_float(value) for value in values], dtype=float)


def is_blank(values: pd.Series) -> np.ndarray:
    """(n,) bool: which cells of a column hold nothing."""
    return np.array(
        [v is None or v != v or (isinstance(v, str) and not v.strip()) for v in values.tolist()], dtype=bool
    )


def _float(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return np.nan


@contextmanager
def readable(file: Path) -> Iterator[None]:
    """What parsers say of a file that is no table, as one InputError."""
    try:
        yield
    except InputError:
        raise
    except pd.errors.EmptyDataError:
        raise InputError(f"{file}: the file is empty; a header and at least one row are needed") from None
    except OSError as error:
        raise unreadable(file, error) from None
    except pd.errors.ParserWarning:
        raise InputError(f"{file}: a row has more fields than the header, which names them") from None
    # pyarrow's and pandas' parsers raise kinds of ValueError, pyarrow another for what it has not got
    except (ValueError, NotImplementedError, csv.Error) as error:
        raise InputError(f"{file}: not a table that can be read: {shortened(error)}") from None


@contextmanager
def parquet(file: Path) -> Iterator[tuple[ParquetFile, list[str]]]:
    """A Parquet file and the names of its columns of plain values. Raises InputError.

    Texts come as dictionaries: a short file may repeat a long one a million times. See `decoded`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.allocate_buffer(1)  # the library's own pool reserves a gigabyte at its first byte: here, where nothing counts
    pa.set_memory_pool(pa.system_memory_pool())
    with readable(file), bounded(file):
        schema = pq.read_schema(file)
        check_names(file, schema.names)
        plain = [field.name for field in schema if not pa.types.is_nested(field.type)]
        texts = [name for name in plain if _is_text(schema.field(name).type)]
        # by default it reads ahead: as much memory as the file has bytes
        opened = pq.ParquetFile(file, buffer_size=1 << 20, pre_buffer=False, read_dictionary=texts)
    with opened:
        yield opened, plain


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    return any(test(kind) for test in (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary))


def _parquet(file: Path) -> pd.DataFrame:
    with parquet(file) as (opened, names):
        _check_size(file, opened.metadata.num_rows, len(names))
        unpacked = sum(opened.metadata.row_group(k).total_byte_size for k in range(opened.metadata.num_row_groups))
        if unpacked > MAX_UNPACKED:
            raise InputError(f"{file}: it unpacks to {unpacked >> 20} MB; allowed are {MAX_UNPACKED >> 20}")
        with bounded(file):
            return decoded(file, opened.read(columns=names, use_threads=False))


def decoded(file: Path, table: Any) -> pd.DataFrame:
    """A pyarrow table or batch with its texts written out, where that is not more than a file may have."""
    import pyarrow as pa
    from pyarrow import compute

    pc: Any = compute  # its functions are made at run time
    table = pa.table(table)
    for k, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):
            if _is_text(field.type.value_type):
                letters = (pc.sum(pc.take(pc.binary_length(c.dictionary), c.indices)) for c in table.column(k).chunks)
                if sum(n.as_py() or 0 for n in letters) > MAX_BYTES:
                    many = f"more than {MAX_BYTES} letters, which are allowed"
                    raise InputError(f"{file}: column {quoted(field.name)}: {many}")
            table = table.set_column(k, field.name, table.column(k).cast(field.type.value_type))
    return table.to_pandas(ignore_metadata=True)
