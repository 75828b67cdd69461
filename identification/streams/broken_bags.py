"""Bags that break off, or have no index: their messages in the order of the file, up to the break.

Formats: MCAP (https://mcap.dev/spec), ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0), and the tables of ROS 2's
sqlite3 storage. Of a compressed chunk that is cut, what unpacks is read.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from kincal.identification.streams.bag_files import database_of

_RECORD = struct.Struct("<BQ")  # of an MCAP: kind, length
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 3, 4, 5, 6, 2
_CHUNK_HEAD = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_ROS1_MESSAGE, _ROS1_CHUNK, _ROS1_CONNECTION = 2, 5, 7
_LARGEST = 1 << 30  # bytes of a chunk
Message = tuple[int, int, bytes]  # channel, time [ns], content


class BreaksOff(Exception):
    """Here a file ends in the midst of a record, or goes on with what is none."""


@dataclass(frozen=True)
class Channel:
    id: int
    topic: str
    msgtype: str
    digest: str = ""


@dataclass
class Scan:
    """One file, read from its begin. broken: the byte (or -1 where no byte is known) at which it breaks off."""

    file: Path
    records: Callable[[Scan], Iterator[Channel | Message]]
    connections: list[Channel] = field(default_factory=list)
    broken: int | None = None

    @classmethod
    def of(cls, file: Path) -> Scan | None:
        """None for a file that is of no known format, or has no channel."""
        with open(file, "rb") as stream:
            head = stream.read(16)
        readers = {b"\x89MCAP0\r\n": _mcap, b"#ROSBAG V2.0": _ros1, b"SQLite format 3\0": _sqlite}
        records = next((read for magic, read in readers.items() if head.startswith(magic)), None)
        if records is None:
            return None
        scan = cls(file, records)
        channels = {r.id: r for r in scan if isinstance(r, Channel)}
        scan.connections = list(channels.values())
        return scan if channels else None

    def __iter__(self) -> Iterator[Channel | Message]:
        try:
            yield from self.records(self)
        except (BreaksOff, struct.error, ValueError, TypeError, LookupError, OSError) as error:
            self.broken = error.args[0] if isinstance(error, BreaksOff) else -1
        except sqlite3.Error:
            self.broken = -1

    def messages(self, connections: Collection[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        by_id = {channel.id: channel for channel in connections}
        for record in self:
            if not isinstance(record, Channel) and record[0] in by_id:
                yield by_id[record[0]], record[1], record[2]

    def close(self) -> None:
        """Nothing stays open."""


def _mcap(scan: Scan) -> Iterator[Channel | Message]:
    with open(scan.file, "rb") as stream:
        stream.seek(8)
        schemas: dict[int, str] = {}
        while head := stream.read(_RECORD.size):
            begin = stream.tell() - len(head)
            if len(head) < _RECORD.size:
                raise BreaksOff(begin)
            kind, length = _RECORD.unpack(head)
            if kind == _FOOTER:
                return
            data = _data(stream, length, kind in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK))
            whole = data is None or len(data) == length
            if data is not None and kind == _CHUNK:
                for inner, content in _mcap_inner(data, whole, begin):
                    yield from _mcap_record(inner, content, schemas)
            elif data is not None and whole:
                yield from _mcap_record(kind, data, schemas)
            if not whole:
                raise BreaksOff(begin)
        raise BreaksOff(stream.tell())


def _mcap_inner(data: bytes, whole: bool, begin: int) -> Iterator[tuple[int, bytes]]:
    """The records of a chunk that are whole."""
    _, _, size, checksum, name = _CHUNK_HEAD.unpack_from(data)
    compression = data[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name].decode()
    unpacked = _unpacked(data[_CHUNK_HEAD.size + name + 8 :], compression, size)
    if whole and (len(unpacked) != size or (checksum and zlib.crc32(unpacked) != checksum)):
        raise BreaksOff(begin)
    at = 0
    while at + _RECORD.size <= len(unpacked):
        kind, length = _RECORD.unpack_from(unpacked, at)
        at += _RECORD.size
        if at + length > len(unpacked):
            return
        yield kind, unpacked[at : at + length]
        at += length


def _mcap_record(kind: int, data: bytes, schemas: dict[int, str]) -> Iterator[Channel | Message]:
    if kind == _SCHEMA:
        schemas[struct.unpack_from("<H", data)[0]] = _text(data, 2)[0]
    elif kind == _CHANNEL:
        channel, schema = struct.unpack_from("<HH", data)
        yield Channel(channel, _text(data, 4)[0], schemas.get(schema, ""))
    elif kind == _MESSAGE:
        channel, _, logged = struct.unpack_from("<HIQ", data)
        yield channel, logged, data[22:]


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A text with its length before it, and where it ends."""
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length


def _ros1(scan: Scan) -> Iterator[Channel | Message]:
    with open(scan.file, "rb") as stream:
        stream.readline(64)
        while head := stream.read(4):
            begin = stream.tell() - len(head)
            fields = _fields(stream.read(struct.unpack("<I", head)[0] if len(head) == 4 else 0))
            size = stream.read(4)
            if len(size) < 4 or not fields:
                raise BreaksOff(begin)
            (length,) = struct.unpack("<I", size)
            kind = fields["op"][0]
            data = _data(stream, length, kind in (_ROS1_CHUNK, _ROS1_CONNECTION, _ROS1_MESSAGE))
            whole = data is None or len(data) == length
            if data is not None and kind == _ROS1_CHUNK:
                unpacked = _unpacked(data, fields["compression"].decode(), struct.unpack("<I", fields["size"])[0])
                yield from _ros1_inner(unpacked)
            elif data is not None and whole:
                yield from _ros1_record(fields, data)
            if not whole:
                raise BreaksOff(begin)


def _ros1_inner(data: bytes) -> Iterator[Channel | Message]:
    at = 0
    while at + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        fields, at = _fields(data[at + 4 : at + 4 + length]), at + 4 + length
        if at + 4 > len(data):
            return
        (length,) = struct.unpack_from("<I", data, at)
        if at + 4 + length > len(data):
            return
        yield from _ros1_record(fields, data[at + 4 : at + 4 + length])
        at += 4 + length


def _ros1_record(fields: dict[str, bytes], data: bytes) -> Iterator[Channel | Message]:
    if fields["op"][0] == _ROS1_CONNECTION:
        of = _fields(data)
        package, _, name = of["type"].decode().rpartition("/")
        kind = f"{package}/msg/{name}" if package and not package.endswith("/msg") else f"{package}/{name}"
        number = struct.unpack("<I", fields["conn"])[0]
        yield Channel(number, fields["topic"].decode(), kind, of["md5sum"].decode())
    elif fields["op"][0] == _ROS1_MESSAGE:
        seconds, nanoseconds = struct.unpack("<II", fields["time"])
        yield struct.unpack("<I", fields["conn"])[0], seconds * 10**9 + nanoseconds, data


def _fields(data: bytes) -> dict[str, bytes]:
    """A ROS 1 header: {name: value}, as many as are whole."""
    fields, at = {}, 0
    while at + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        if at + 4 + length > len(data):
            return {}
        fields[name.decode()] = value
        at += 4 + length
    return fields


def _sqlite(scan: Scan) -> Iterator[Channel | Message]:
    with closing(database_of(scan.file)) as database:
        for number, topic, kind in database.execute("select id, name, type from topics"):
            yield Channel(number, str(topic), str(kind))
        rows = database.execute("select topic_id, timestamp, data from messages not indexed")
        yield from _off_last_page(scan.file, database, rows)


def _off_last_page(file: Path, database: sqlite3.Connection, rows: Iterable[Message]) -> Iterator[Message]:
    """Without the rows that the last page may hold, where it is cut: the library fills it up with zeros."""
    (page,) = database.execute("pragma page_size").fetchone()
    size = file.stat().st_size
    if size % page == 0:
        yield from rows
        return
    held: deque[Message] = deque()
    letters = 0
    for row in rows:
        held.append(row)
        letters += len(row[2])
        while letters - len(held[0][2]) >= page:
            letters -= len(held[0][2])
            yield held.popleft()
    raise BreaksOff(size)


def _data(stream: BinaryIO, length: int, wanted: bool) -> bytes | None:
    """A record's content, shorter where the file ends; None where it is skipped. Raises BreaksOff."""
    begin = stream.tell()
    end = stream.seek(0, 2)
    if wanted and min(length, end - begin) > _LARGEST:
        raise BreaksOff(begin)
    stream.seek(begin)
    if wanted or begin + length > end:
        return stream.read(min(length, end - begin))
    stream.seek(begin + length)
    return None


def _unpacked(data: bytes, compression: str, size: int) -> bytes:
    """What a chunk holds, or what of it unpacks."""
    if compression in ("", "none"):
        return data[:size]
    try:
        return _decompressor(compression).decompress(data, max_length=min(size, _LARGEST))
    except MemoryError:
        raise
    except Exception as error:  # each library has its own errors
        raise BreaksOff(-1) from error


def _decompressor(compression: str) -> Any:
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    if compression == "zstd":
        from rosbags.rosbag2.storage_mcap import zstd  # of Python 3.14, or its backport: rosbags knows which

        return zstd.ZstdDecompressor()
    return {"bz2": bz2.BZ2Decompressor}[compression]()
