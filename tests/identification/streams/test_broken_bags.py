"""Bags that rosbags' own writers made and that then lost their end: what is read is the begin of the whole."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from kincal.identification.streams.broken_bags import Scan
from kincal.identification.streams.reading import read_log
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError

VECTOR = "geometry_msgs/msg/Vector3Stamped"
ANGLES = np.random.default_rng(8).uniform(-0.4, 0.4, (3000, 3))
T = 1.7e9 + 0.01 * np.arange(3000)


def write(folder: Path, kind: str) -> Path:
    """One file: vectors on a topic, and another topic beside it."""
    ros1 = kind.startswith("ros1")
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types, path = store.types, folder / (f"{kind}.bag" if ros1 else kind)
    storage = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=storage)
    if kind == "ros1 bz2":
        writer.set_compression(Writer1.CompressionFormat.BZ2)
    if kind == "ros1 lz4":
        writer.set_compression(Writer1.CompressionFormat.LZ4)
    if kind == "mcap zstd":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    encode = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        tilt = writer.add_connection("/tilt", VECTOR, typestore=store)
        other = writer.add_connection("/other", "std_msgs/msg/String", typestore=store)
        for t, angles in zip(T, ANGLES, strict=True):
            stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **({"seq": 0} if ros1 else {}))
            message = types[VECTOR](header=header, vector=types["geometry_msgs/msg/Vector3"](*angles))
            writer.write(tilt, round(t * 1e9), bytes(encode(message, VECTOR)))
            text = types["std_msgs/msg/String"](data="beside")
            writer.write(other, round(t * 1e9), bytes(encode(text, "std_msgs/msg/String")))
    return path if ros1 else next(f for f in path.iterdir() if f.suffix in (".mcap", ".db3"))


KINDS = ("mcap", "mcap zstd", "sqlite3", "ros1", "ros1 bz2", "ros1 lz4")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return {kind: write(folder, kind) for kind in KINDS}


def read(file: Path):
    return read_log(file, Measure(streams=file, table=Path("joints.csv")))


@pytest.mark.parametrize("kind", KINDS)
def test_the_scan_reads_what_the_library_reads(kind, files):
    scan = Scan.of(files[kind])
    assert scan is not None
    assert {c.topic for c in scan.connections} == {"/tilt", "/other"}
    chosen = [c for c in scan.connections if c.topic == "/tilt"]
    times = [t for _, t, _ in scan.messages(chosen)]
    np.testing.assert_allclose(np.array(times) / 1e9, T)
    assert scan.broken is None


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.25, 0.5, 0.8, 0.95])
def test_a_file_that_breaks_off(kind, share, files, tmp_path):
    """As many samples as that share of the file can hold, each right, and a note."""
    content = files[kind].read_bytes()
    file = tmp_path / files[kind].name
    file.write_bytes(content[: int(share * len(content))])
    if kind == "ros1 bz2" and share < 0.8:
        return  # it unpacks whole blocks of 900 kB alone
    samples, health = read(file)
    n = len(samples)
    which = np.round((samples["t"].to_numpy(float) - T[0]) * 100).astype(int)  # a database may lose some amidst
    np.testing.assert_allclose(samples["roll"], ANGLES[which, 0])
    assert which[-1] < 1.02 * n
    assert 0.5 * share * len(T) < n <= len(T)  # an index at the end holds no sample
    assert any(f"{file.name} breaks off" in line for line in health.lines())


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_folder_without_metadata(kind, files, tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    shutil.copy(files[kind], folder)
    samples, health = read(folder)
    assert len(samples) == len(T)
    assert health.lines() == ("metadata.yaml is missing; kincal read the folder's files without it",)
    (folder / "metadata.yaml").write_text("")
    samples, health = read(folder)
    assert len(samples) == len(T)
    assert health.lines()[0].startswith("metadata.yaml does not open the folder's files")


def test_parts_of_a_folder_come_in_their_order_and_the_last_may_break_off(files, tmp_path):
    content = files["mcap"].read_bytes()
    for k in (2, 10):
        (tmp_path / f"bag_{k}.mcap").write_bytes(content if k == 2 else content[: len(content) // 3])
    samples, health = read(tmp_path)
    assert len(T) < len(samples) == health.read
    np.testing.assert_allclose(samples["roll"][:3000], ANGLES[:, 0])
    np.testing.assert_allclose(samples["roll"][3000:], ANGLES[: len(samples) - 3000, 0])
    assert any("bag_10.mcap breaks off" in line for line in health.lines())


def test_a_folder_with_nothing_in_it(tmp_path):
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(InputError, match=r"it has no metadata\.yaml, and no file \.mcap or \.db3"):
        read(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_damage_ends_in_samples_or_a_refusal(kind, data, files, tmp_path):
    content = bytearray(files[kind].read_bytes())
    del content[data.draw(st.integers(20, len(content))) :]
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=6)):
        content[place] = data.draw(st.integers(0, 255))
    file = tmp_path / files[kind].name
    file.write_bytes(content)
    try:
        samples, health = read(file)
    except InputError:
        return
    assert len(samples) <= health.samples <= health.read
