"""What is kept of a stream is bounded, whatever its format; what is only read may be much longer."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kincal.identification import table_files, workbook_size
from kincal.identification.streams import stillness
from kincal.identification.streams.reading import open_stream, read_log, read_stream
from kincal.identification.streams.static_poses import static_poses
from kincal.identification.table_files import load
from kincal.urdf import input_files
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError

SAMPLES = Path(__file__).parents[3] / "docs" / "samples"
JOINTS = ("leg1_slide", "leg2_slide", "leg3_slide")


def packed(file: Path, rows: int, groups: int = 1) -> Path:
    """A Parquet stream of zeros: a few bytes for millions of rows."""
    zeros = np.zeros(rows, dtype=np.int8)
    table = pa.table(dict.fromkeys(("t", "pose", "roll", "pitch"), zeros))
    with pq.ParquetWriter(file, table.schema, compression="zstd") as writer:
        for _ in range(groups):
            writer.write_table(table, row_group_size=rows)
    return file


def test_a_parquet_stream_is_refused_by_its_rows(tmp_path, monkeypatch):
    """By what its footer says: nothing is unpacked."""
    file = packed(tmp_path / "stream.parquet", 2_000_000, 10)
    assert file.stat().st_size < 1 << 20
    monkeypatch.setattr(pq.ParquetFile, "iter_batches", None)
    with pytest.raises(
        InputError, match=r"stream.parquet: 20000000 samples, 80000000 numbers .* allowed are 64000000 "
    ):
        read_stream(file, Measure())


def test_a_log_is_refused_by_its_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(input_files, "MAX_RECORDS", 999)
    file = packed(tmp_path / "stream.parquet", 1_000)
    with pytest.raises(InputError, match="1000 records; allowed are 999"):
        read_log(file, Measure(commands=SAMPLES / "commands.csv", streams=file))


@pytest.mark.parametrize("name", ["stream.csv", "log.nmea", "bag"])
def test_what_is_kept_of_any_log(tmp_path, monkeypatch, name):
    file = tmp_path / name
    if name == "stream.csv":
        pd.DataFrame({"t": np.arange(500) / 10, "pose": 1, "roll": 0.1, "pitch": 0.1}).to_csv(file, index=False)
    elif name == "bag":
        shutil.copytree(SAMPLES / name, file)
    else:
        shutil.copy(SAMPLES / name, file)
    measure = Measure(streams=file, table="-", log=Log(rate_hz=10.0))
    monkeypatch.setattr(input_files, "MAX_KEPT", 1_000)
    with pytest.raises(InputError, match=rf"{name}: \d+ samples, \d+ numbers in all; allowed are 1000 .*Keep every"):
        read_log(file, measure)
    monkeypatch.setattr(input_files, "MAX_RECORDS", 100)
    with pytest.raises(InputError, match=rf"{name}: \d+ records; allowed are 100. Cut the file"):
        for _ in open_stream(file, measure):
            pass


def test_what_is_kept_of_a_log_with_commands(monkeypatch):
    """Bins of the whole log, and the samples within the windows."""
    measure = Measure(streams=SAMPLES / "log.nmea", commands=SAMPLES / "commands.csv")
    kept = static_poses(measure, JOINTS).stream.size
    monkeypatch.setattr(input_files, "MAX_KEPT", kept // 2)
    with pytest.raises(InputError, match=r"log.nmea: \d+ samples, \d+ numbers"):
        static_poses(measure, JOINTS)


def test_samples_of_no_time(monkeypatch):
    """All of them in one bin: they would be kept until it ends."""
    monkeypatch.setattr(stillness, "_MOST_SAMPLES", 1_000)
    chunks = (pd.DataFrame({"t": (k + np.arange(600) / 600) * 1e-6, "roll": 0.0, "pitch": 0.0}) for k in range(5))
    with pytest.raises(InputError, match=r"log.csv: 1200 samples within 0.2 s; allowed are 1000. Check the unit of t"):
        stillness.binned(chunks, Path("log.csv"))


def test_a_table_is_refused_by_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(table_files, "MAX_UNPACKED", 1 << 20)
    numbers = pa.table({"x": np.arange(300_000.0)})
    pq.write_table(numbers, tmp_path / "poses.parquet", use_dictionary=False)
    with pytest.raises(InputError, match=r"poses.parquet: it unpacks to 2 MB; allowed are 1"):
        load(tmp_path / "poses.parquet", Measure())


def workbook(file: Path, last: str) -> Path:
    """Two cells: A1, and one far away."""
    book = f'xmlns="{OFFICE}/spreadsheetml/2006/main"'
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{PACKAGE}/content-types"><Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/></Types>',
        "_rels/.rels": relation("officeDocument", "xl/workbook.xml"),
        "xl/workbook.xml": f'<workbook {book} xmlns:r="{OFFICE}/officeDocument/2006/relationships"><sheets>'
        '<sheet name="S" sheetId="1" r:id="r1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": relation("worksheet", "worksheets/sheet1.xml"),
        "xl/worksheets/sheet1.xml": f'<worksheet {book}><sheetData><row r="1"><c r="A1"><v>1</v></c></row>'
        f'<row r="1048576"><c r="{last}1048576"><v>1</v></c></row></sheetData></worksheet>',
    }
    with zipfile.ZipFile(file, "w") as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return file


OFFICE, PACKAGE = "http://schemas.openxmlformats.org", "http://schemas.openxmlformats.org/package/2006"


def relation(kind: str, target: str) -> str:
    return (
        f'<Relationships xmlns="{PACKAGE}/relationships"><Relationship Id="r1" Target="{target}" '
        f'Type="{OFFICE}/officeDocument/2006/relationships/{kind}"/></Relationships>'
    )


def test_a_sheet_of_two_cells_that_spans_a_whole_sheet(tmp_path, monkeypatch):
    """17 thousand million cells of 32 bytes: the reader reserves them all, and aborts."""
    with pytest.raises(InputError, match=r"far.xlsx: its sheets take more than 2048 MB .* save the table as CSV"):
        load(workbook(tmp_path / "far.xlsx", "XFD"), Measure())
    monkeypatch.setattr(workbook_size, "MAX_SHEET_CELLS", 1_000_000)
    with pytest.raises(InputError, match=r"near.xlsx: its sheets span 2097152 cells; allowed are 1000000"):
        load(workbook(tmp_path / "near.xlsx", "B"), Measure())
