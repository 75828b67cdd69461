"""ROS 1 bags, ROS 2 bags (sqlite3, mcap) and MCAP files, by rosbags: sensor_msgs/Imu, geometry_msgs/Vector3Stamped.

Axes after REP 103: x forward, y to port, z up, as kincal's. A Vector3Stamped holds roll, pitch [rad] in x, y, unless
a column map says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import UNITS
from kincal.identification.streams.bag_files import check_bag
from kincal.identification.streams.bag_readers import Parts, Types, opened
from kincal.identification.streams.health import Tally
from kincal.identification.streams.imu import imu_chunk, imu_row, orientation_of
from kincal.urdf.description import Column, Measure, listed
from kincal.urdf.errors import InputError, quoted, shortened
from kincal.urdf.input_files import bounded, bounded_each

IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3Stamped"
_ROWS = 5_000  # messages a chunk


def logged(file: Path, measure: Measure, tally: Tally) -> Iterator[pd.DataFrame]:
    """Chunks of t, roll, pitch, yaw and of an Imu gyro_x..z, acc_x..z; t is the header's, else the recorder's.

    Raises InputError for a bag that can't be opened, and where no topic or more than one fits.
    """
    # a damaged bag makes its reader fail in any way: struct, key, yaml, sqlite and memory errors were all seen
    try:
        check_bag(file)
        with bounded(file):
            reader, types = opened(file)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{file}: not a bag that can be read: {_first_line(error)}") from None
    try:
        kind, connections = _topic(file, reader.connections, measure.log.topic)
        _check_type(file, kind, connections, types)
        chunk = _imu(file, reader, connections, types, measure, tally) if kind == IMU else _vector_chunk(file, measure)
        for rows in bounded_each(file, _rows(_messages(reader, connections, tally), kind, types, tally)):
            yield chunk(np.array(rows))
        tally.notes += (*reader.notes, *reader.faults())
    finally:
        reader.close()


def _imu(
    file: Path, reader: Parts, connections: list[Any], types: Types, measure: Measure, tally: Tally
) -> Callable[[np.ndarray], pd.DataFrame]:
    """How rows of an Imu become a chunk: by its orientation, if it has one."""

    def decoded() -> Iterator[Any]:
        for raw, _ in _messages(reader, connections, Tally()):
            try:
                yield types.deserialize(raw, IMU)
            except Exception:  # it is counted when the samples are read
                continue

    with bounded(file):
        orientation = orientation_of(decoded(), measure.log.orientation)
    if orientation.note:
        tally.notes += (f"topic {connections[0].topic}: {orientation.note}",)
    return partial(imu_chunk, orientation=orientation)


def _check_type(file: Path, kind: str, connections: list[Any], types: Types) -> None:
    other = next((c.digest for c in connections if c.digest not in ("", types.digest(kind))), None)
    if other is not None:
        raise InputError(f"{file}: its {kind} is another type than ROS's own: {other}; allowed is {types.digest(kind)}")


def _rows(
    messages: Iterable[tuple[bytes, float]], kind: str, types: Types, tally: Tally
) -> Iterator[list[tuple[float, ...]]]:
    """Rows of many messages at a time."""
    row = imu_row if kind == IMU else _vector_row
    rows: list[tuple[float, ...]] = []
    for rawdata, recorded in messages:
        try:
            message = types.deserialize(rawdata, kind)
            rows.append((_time(message, recorded), *row(message)))
        except Exception:
            tally.garbage += 1
        if len(rows) >= _ROWS:
            yield rows
            rows = []
    if rows:
        yield rows


def _messages(reader: Any, connections: list[Any], tally: Tally) -> Iterator[tuple[bytes, float]]:
    """Raw messages and when they were recorded [s]; where the file breaks off, one record more that is garbage."""
    messages = reader.messages(connections=connections)
    while True:
        try:
            _, nanoseconds, rawdata = next(messages)
            seconds = float(nanoseconds) * 1e-9
        except StopIteration:
            return
        except Exception:
            tally.read, tally.garbage = tally.read + 1, tally.garbage + 1
            return
        tally.read += 1
        yield rawdata, seconds


def _topic(file: Path, connections: list[Any], wanted: str | None) -> tuple[str, list[Any]]:
    """The type and the connections of the topic that is read."""
    fitting = [c for c in connections if c.msgtype in (IMU, VECTOR)]
    topics = sorted({c.topic for c in fitting})
    has = listed(sorted({f"{c.topic} ({c.msgtype})" for c in connections})) or "none"
    if wanted is None and len(topics) > 1:
        raise InputError(f"{file}: topics {listed(topics)} all fit; set measure.log.topic to one of them")
    if not topics or (wanted is not None and wanted not in topics):
        which = f"topic {quoted(wanted)} is" if wanted else "there is"
        raise InputError(f"{file}: {which} none of {IMU} or {VECTOR}; it has {has}")
    chosen = [c for c in fitting if c.topic == (wanted or topics[0])]
    return chosen[0].msgtype, [c for c in chosen if c.msgtype == chosen[0].msgtype]


def _time(message: Any, recorded: float) -> float:
    stamp = message.header.stamp
    seconds = stamp.sec + 1e-9 * stamp.nanosec
    return seconds if seconds else recorded


def _vector_row(message: Any) -> tuple[float, ...]:
    return (message.vector.x, message.vector.y, message.vector.z)


def _vector_chunk(file: Path, measure: Measure) -> Callable[[np.ndarray], pd.DataFrame]:
    """roll, pitch (and yaw where measure.columns names it) from x, y, z of the vector, in the map's units."""
    source = {"x": 1, "y": 2, "z": 3}
    chosen = {"roll": Column.model_validate({"from": "x"}), "pitch": Column.model_validate({"from": "y"})}
    chosen |= {name: column for name, column in measure.columns.items() if name in ("roll", "pitch", "yaw")}
    for name, column in chosen.items():
        if column.source.removeprefix("vector.") not in source:
            raise InputError(
                f"{file}: measure.columns.{name}: found {quoted(column.source)}; "
                "of a Vector3Stamped allowed are x, y, z"
            )
    places = {name: (source[c.source.removeprefix("vector.")], UNITS[c.unit]) for name, c in chosen.items()}
    return lambda rows: pd.DataFrame({"t": rows[:, 0]} | {n: rows[:, k] * unit for n, (k, unit) in places.items()})


def _first_line(error: Exception) -> str:
    return shortened(f"{type(error).__name__}: {error}")
