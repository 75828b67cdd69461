"""Bags by somebody who means harm: databases that are programs, types that are none, chunks without end."""

import os
import resource
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from kincal.identification.streams.reading import read_log
from kincal.urdf import input_files
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError
from kincal.urdf.input_files import bounded
from tests.fuzz.seeds import bags


@pytest.fixture
def bag(tmp_path):
    """bag(kind): a file or a folder."""

    def write(kind: str):
        folder = tmp_path / "bag"
        folder.mkdir()
        for name, content in bags()[kind].items():
            (folder / name).write_bytes(content)
        return folder / "log.bag" if kind.startswith("ros1") else folder

    return write


def read(file, **log):
    return read_log(file, Measure(streams=file, table="-", log=Log(format="bag", **log)))


def refused(file, *said: str, **log) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as refusal:
        read(file, **log)
    assert time.process_time() - began < 5
    for text in said:
        assert text in str(refusal.value)


ENDLESS = (
    "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) "
    "SELECT k AS id, 1 AS topic_id, k AS timestamp, x'00' AS data FROM n"
)
PROGRAMS = {
    "a view without end": f"alter table messages rename to old; create view messages as {ENDLESS}",
    "a computed column": "alter table messages add column more text generated always as (hex(data) || hex(data))",
    "a trigger": "create trigger more after insert on topics begin delete from messages; end",
    "a virtual table": "create virtual table more using fts5(a)",
}


@pytest.mark.parametrize("statements", PROGRAMS.values(), ids=PROGRAMS)
def test_a_database_holds_tables_alone(statements, bag):
    folder = bag("sqlite3")
    (file,) = folder.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.executescript(statements)
    refused(folder, file.name, "is no plain table or index")


def test_metadata_without_anchors(bag):
    """Ten lines of YAML that stand for a thousand million words."""
    folder = bag("mcap")
    bomb = "a0: &a0 [ha, ha]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 10))
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(bomb + text.replace("compression_format: ''", "compression_format: *a9"))
    refused(folder, "metadata.yaml", "anchors")


def test_a_pipe_in_a_bag(bag):
    folder = bag("mcap")
    (file,) = folder.glob("*.mcap")
    file.unlink()
    os.mkfifo(file)
    refused(folder, file.name, "pipe or a device")


@pytest.mark.parametrize("array", ["geometry_msgs/Vector3[1000000] more", "float64[1000000000] more"])
def test_a_files_own_types_are_not_compiled(array, bag):
    """The definition in a file may be any program of arrays in arrays; ROS's own types are what is decoded by."""
    file = bag("ros1")
    before, _ = read(file)
    content = file.read_bytes()
    old = b"geometry_msgs/Vector3 angular_velocity"
    at = content.index(old)
    new = array.encode().ljust(len(old))[: len(old)]
    file.write_bytes(content[:at] + new + content[at + len(old) :])
    samples, _ = read(file)
    assert samples.equals(before)


def test_another_type_of_that_name(bag):
    """Its digest says that it is laid out otherwise."""
    file = bag("ros1")
    content = file.read_bytes()
    assert content.count(b"6a62c6daae103f4ff57a132d6f95cec2") >= 1
    file.write_bytes(content.replace(b"6a62c6daae103f4ff57a132d6f95cec2", b"0" * 32))
    refused(file, "log.bag", "another type than ROS's own")


def test_a_message_that_unpacks_to_gigabytes(tmp_path, monkeypatch):
    """30 KB a gigabyte; bound and bomb are smaller here."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/sensor", "sensor_msgs/msg/Imu", typestore=types)
        writer.write(connection, 1, bytes(900 << 20))
    assert sum(f.stat().st_size for f in (tmp_path / "bag").iterdir()) < 200_000
    monkeypatch.setattr(input_files, "MAX_UNPACKED", 300 << 20)
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak()
    refused(tmp_path / "bag", "0 of 1 records")
    assert _peak() - before < 450  # half of the message: the bound of 300, and what the allocator keeps beside it


def _peak() -> float:
    """[MB] since it was cleared."""
    status = Path("/proc/self/status").read_text()
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))


def test_the_bound_is_lifted_again(tmp_path, monkeypatch):
    limits = resource.getrlimit(resource.RLIMIT_AS)
    monkeypatch.setattr(input_files, "MAX_UNPACKED", 50 << 20)
    with pytest.raises(InputError, match=r"some\.mat: it unpacks to more than 50 MB"), bounded(tmp_path / "some.mat"):
        bytes(8 << 30)  # more than any heap has left free
    assert resource.getrlimit(resource.RLIMIT_AS) == limits


def test_no_folder_is_left_behind(bag, tmp_path):
    folder = bag("mcap zstd")
    before = {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    read(folder)
    assert {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()} == before
