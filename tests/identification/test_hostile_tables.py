"""Tables by somebody who means harm: refused before they are unpacked, in one line."""

import gzip
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kincal.identification import table_files
from kincal.identification.measurement_table import read_table
from kincal.identification.streams.reading import read_log
from kincal.identification.table_files import load
from kincal.urdf import input_files
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError


def refused(read, *said: str) -> None:
    """By an InputError, soon, and with less than 300 MB."""
    began, before = time.process_time(), _peak()
    with pytest.raises(InputError) as refusal:
        read()
    assert time.process_time() - began < 4
    assert _peak() - before < 300
    for text in said:
        assert text in str(refusal.value)


def _peak() -> float:
    """[MB] that this process ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(file: Path):
    return read_table(file, ("a",), Measure(table=file))


def stream(file: Path, form: str | None = None):
    return read_log(file, Measure(streams=file, table="-", log=Log(format=form)))


WHOLE = "pose,a,x,y,z\n0,1,2,3,4\n"
CSV = {
    "a million columns": (",".join(f"c{k}" for k in range(1_000_000)) + "\n", "longer than"),
    "many columns": (",".join(f"c{k}" for k in range(5000)) + "\n", "5000 columns; allowed are 2000"),
    "a header without end": ("x" * (2 << 20), "longer than"),
    "a row without end": (WHOLE + "1" * (30 << 20), "longer than"),
    "fields without end": (WHOLE + "1," * (4 << 20), "longer than"),
    "a quote without end": ('pose,"a,x,y,z\n' + "0,1,2,3,4\n" * 500_000, "table.csv"),
    "a row that is longer than the header": ("pose,a,x,y,z\n0,1,2,3,4,5\n", "more fields than the header"),
    "a longer row later": (WHOLE + "1,2,3,4,5,6\n", "table.csv"),
    "many digits": (WHOLE + f"1,{'9' * 400},2,3,4\n", "'a', row 2"),
    "a number beyond all squares": (WHOLE + "1,1e300,2,3,4\n", "finite numbers below 1e+15"),
    "a pose beyond whole numbers": (WHOLE + "1e300,1,2,3,4\n", "'pose', row 2"),
    "control characters": ("po\x1bse\x00,a\n0,1\n", "nothing was measured"),
}  # fmt: skip


@pytest.mark.parametrize("text, said", CSV.values(), ids=CSV)
def test_hostile_csv(text, said, tmp_path):
    file = tmp_path / "table.csv"
    file.write_text(text)
    refused(lambda: table(file), "table.csv", said)


def test_rows_and_cells_have_limits(tmp_path, monkeypatch):
    file = tmp_path / "table.csv"
    file.write_text(WHOLE * 50)
    monkeypatch.setattr(table_files, "MAX_ROWS", 80)
    refused(lambda: table(file), "100 rows of 5 columns; allowed are 80 rows")
    monkeypatch.setattr(table_files, "MAX_BYTES", 100)
    refused(lambda: table(file), f"{file.stat().st_size} bytes; allowed are 100")


@pytest.mark.parametrize("name", ["table.csv", "table.csv.gz", "table.csv.zip"])
def test_compressed_tables_are_not_unpacked(name, tmp_path):
    file = tmp_path / name
    file.write_bytes(gzip.compress(WHOLE.encode() + b"0" * (5 << 20)))
    refused(lambda: table(file), name, "compressed; unpack it first")
    refused(lambda: stream(file, "csv"), name, "compressed; unpack it first")


@pytest.mark.parametrize("name", ["table.csv", "table.parquet", "table.nmea", "table"])
def test_what_is_no_file(name, tmp_path):
    """Who reads a pipe waits for a writer, and a device has no end."""
    file = tmp_path / name
    os.mkfifo(file)
    refused(lambda: table(file), name, "pipe or a device")
    refused(lambda: stream(file), name, "pipe or a device")
    file.unlink()
    file.symlink_to("/dev/zero")
    refused(lambda: table(file), name, "pipe or a device")
    refused(lambda: stream(file), name, "pipe or a device")
    refused(lambda: stream(file, "nmea"), name, "pipe or a device")
    file.unlink()
    file.mkdir()
    refused(lambda: table(file), name, "folder")


# Parquet


def written(columns: dict, file: Path, **options) -> Path:
    pq.write_table(pa.table(columns), file, **options)
    return file


def test_a_text_that_is_repeated_a_million_times(tmp_path):
    """3 KB that unpack to 10 GB."""
    index = pa.array(np.zeros(1_000_000, dtype=np.int32))
    long = pa.DictionaryArray.from_arrays(index, pa.array(["1" * 10_000]))
    file = written({"pose": pa.array(np.arange(1_000_000)), "a": long, "x": long, "t": long}, tmp_path / "t.parquet")
    assert file.stat().st_size < 10e6
    refused(lambda: table(file), "t.parquet", "letters, which are allowed")


def test_more_rows_than_anybody_measures(tmp_path):
    """A hundred million numbers in a few kilobytes."""
    zeros = np.zeros(5_000_000)
    file = written({"a": zeros, "pose": zeros, "x": zeros}, tmp_path / "t.parquet", compression="zstd")
    assert file.stat().st_size < 100e3
    refused(lambda: table(file), "t.parquet", "5000000 rows of 3 columns; allowed are 4000000 rows")


def test_a_page_that_unpacks_to_gigabytes(tmp_path, monkeypatch):
    """Bound and bomb are smaller here: 250 MB in 100 KB."""
    zeros, options = np.zeros(31_250_000), {"use_dictionary": False, "write_statistics": False}
    file = written({"a": zeros}, tmp_path / "t.parquet", compression="zstd", data_page_size=1 << 30, **options)
    assert file.stat().st_size < 200e3
    del zeros
    monkeypatch.setattr(table_files, "MAX_ROWS", 1 << 40)
    monkeypatch.setattr(table_files, "MAX_CELLS", 1 << 40)
    monkeypatch.setattr(input_files, "MAX_UNPACKED", 100 << 20)
    refused(lambda: table(file), "t.parquet: it unpacks to more than 100 MB")


def test_the_bound_leaves_room_for_a_process_that_has_just_begun(tmp_path):
    """Libraries reserve memory at their first call, which no file is to blame for."""
    columns = {name: [1.0, 2.0] for name in ("pose", "a", "x", "y", "z")}
    written(columns, tmp_path / "t.parquet")
    code = """
from pathlib import Path
from kincal.identification.table_files import load
from kincal.urdf.description import Measure
assert len(load(Path('t.parquet'), Measure())) == 2
"""
    call = [sys.executable, "-c", code]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    done = subprocess.run(call, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_metadata_that_nobody_can_use(tmp_path):
    columns = {name: [1.0, 2.0] for name in ("pose", "a", "x", "y", "z")}
    for pandas in ({"columns": 7}, [], {"index_columns": ["gone"]}, "{"):
        named = pa.table(columns).replace_schema_metadata({"pandas": json.dumps(pandas)})
        pq.write_table(named, tmp_path / "t.parquet")
        assert len(load(tmp_path / "t.parquet", Measure())) == 2


@pytest.mark.parametrize(
    "column, said",
    [
        (pa.array([[1.0], [2.0]]), "column 'a' (a) is missing"),
        (pa.array([{"b": 1}, {"b": 2}]), "column 'a' (a) is missing"),
        (pa.array([None, None]), "row 1: found None"),
        (pa.array(["1", "one"]), "row 2: found 'one'"),
        (pa.array([b"\xff", b"1"]), "t.parquet"),
        (pa.array([True, False]), "row 1: found True"),
        (pa.array([2**64 - 1, 1], pa.uint64()), "finite numbers below"),
    ],
    ids=str,
)
def test_columns_that_hold_no_numbers(column, said, tmp_path):
    others = {name: [1.0, 2.0] for name in ("pose", "x", "y", "z")}
    file = written(others | {"a": column}, tmp_path / "t.parquet")
    refused(lambda: table(file), "t.parquet", said)


def test_names_that_stand_there_twice(tmp_path):
    twice = pa.Table.from_arrays([pa.array([1.0])] * 3, names=["a", "a", "x"])
    pq.write_table(twice, tmp_path / "t.parquet")
    refused(lambda: table(tmp_path / "t.parquet"), "column 'a' appears twice")
    nested = pa.Table.from_arrays([pa.array([1.0]), pa.array([{"b": 1}])], names=["a", "a"])
    pq.write_table(nested, tmp_path / "n.parquet")
    refused(lambda: table(tmp_path / "n.parquet"), "column 'a' appears twice")


def test_numbers_as_text_are_numbers(tmp_path):
    """As other programs write them: a limit is no reason to refuse these."""
    frame = pd.DataFrame({"pose": ["0", "1"], "a": ["0.5", "0.6"], "x": [1, 2], "y": [1, 2], "z": ["1e-3", "2"]})
    frame.to_parquet(tmp_path / "t.parquet")
    np.testing.assert_array_equal(table(tmp_path / "t.parquet")["a"], [0.5, 0.6])
    frame.astype({"a": "category"}).to_parquet(tmp_path / "t.parquet")
    np.testing.assert_array_equal(table(tmp_path / "t.parquet")["a"], [0.5, 0.6])
