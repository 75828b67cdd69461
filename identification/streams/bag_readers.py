"""Which reader opens a bag: rosbags', or the one of bags that break off; ROS 2 folders without metadata.yaml."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kincal.identification.streams.broken_bags import Scan
from kincal.urdf.errors import InputError

METADATA = "metadata.yaml"
_STORAGE = (".mcap", ".db3")


@dataclass(frozen=True)
class Types:
    """ROS's own messages: (raw, type) -> message, and a type's digest."""

    deserialize: Callable[[bytes, str], Any]
    digest: Callable[[str], str]


@dataclass
class Parts:
    """The files of a bag, one after the other. notes: what is not as it should be."""

    readers: list[tuple[Path, Any]]
    notes: list[str] = field(default_factory=list)

    @property
    def connections(self) -> list[Any]:
        return [connection for _, reader in self.readers for connection in reader.connections]

    def messages(self, connections: Collection[Any]) -> Iterator[tuple[Any, int, bytes]]:
        wanted = {(c.topic, c.msgtype) for c in connections}
        for _, reader in self.readers:
            chosen = [c for c in reader.connections if (c.topic, c.msgtype) in wanted]
            if chosen:  # none would mean all
                yield from reader.messages(connections=chosen)

    def faults(self) -> list[str]:
        """After the messages: where files break off."""
        return [_fault(file, reader.broken) for file, reader in self.readers if isinstance(reader, Scan)]

    def close(self) -> None:
        for _, reader in self.readers:
            reader.close()


def opened(file: Path) -> tuple[Parts, Types]:
    """A bag, a file or a folder, and the types by which its messages are decoded: ROS's own, a file's may be anything.

    Raises InputError, or what rosbags raises, for a bag that can't be read at all.
    """
    from rosbags.typesys import Stores, get_typestore

    ros1 = file.suffix == ".bag" or (file.is_file() and _starts(file, b"#ROSBAG"))
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = Types(store.deserialize_cdr, store.hash_rihs01)
    if ros1:
        types = Types(store.deserialize_ros1, lambda kind: store.generate_msgdef(kind)[1])
    if file.is_dir() and not (file / METADATA).exists():
        return Parts(_parts(file), [f"{METADATA} is missing; kincal read the folder's files without it"]), types
    try:
        return Parts([(file, _reader(file))]), types
    except Exception:
        if file.is_dir() and (parts := _parts(file, lenient=True)):
            return Parts(parts, [f"{METADATA} does not open the folder's files; kincal read them one by one"]), types
        if file.is_file() and (parts := _scans([file])):
            return Parts(parts), types
        raise


def _parts(folder: Path, lenient: bool = False) -> list[tuple[Path, Any]]:
    """Readers of a folder's storage files, in the order of their numbers."""
    files = sorted((f for f in folder.iterdir() if f.suffix in _STORAGE), key=_number)
    if not files and not lenient:
        raise InputError(f"{folder}: it has no {METADATA}, and no file {' or '.join(_STORAGE)}; allowed is a ROS 2 bag")
    readers: list[tuple[Path, Any]] = []
    for file in files:
        try:
            readers.append((file, _reader(file)))
        except Exception:
            readers += _scans([file])
    if not readers and not lenient:
        raise InputError(f"{folder}: none of its files {', '.join(f.name for f in files[:5])} can be read")
    return readers


def _scans(files: list[Path]) -> list[tuple[Path, Any]]:
    return [(file, scan) for file in files if (scan := Scan.of(file)) is not None]


def _reader(file: Path) -> Any:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    reader: Any = Reader1(file) if file.is_file() and _starts(file, b"#ROSBAG") else Reader2(file)
    reader.open()
    return reader


def _starts(file: Path, magic: bytes) -> bool:
    with open(file, "rb") as stream:
        return stream.read(len(magic)) == magic


def _number(file: Path) -> tuple[list[int], str]:
    return [int(digits) for digits in re.findall(r"\d+", file.stem)[-1:]], file.name


def _fault(file: Path, broken: int | None) -> str:
    if broken is None:
        return f"{file.name} has no index that can be read; kincal read its messages in order"
    where = f" in the record at byte {broken}" if broken >= 0 else ""
    return f"{file.name} breaks off{where}; kincal read the messages before"
