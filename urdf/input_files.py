"""Files that others wrote: which are opened at all, how large they may be, and how deep."""

from __future__ import annotations

import os
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from kincal.urdf.errors import InputError

MAX_TOML = 1 << 20  # bytes
MAX_DRAWING = 16 << 20  # bytes of a URDF or an MJCF: text without its meshes
MAX_UNPACKED = 1 << 30  # bytes of memory that a compressed or binary file may take
MAX_RECORDS = 200_000_000  # lines, rows or messages of a stream: 23 days at 100 Hz
MAX_KEPT = 64_000_000  # numbers of a stream that stay in memory: 512 MB
MAX_KEY = 100  # parts of a dotted key: tomllib's time grows with the square of it
_Item = TypeVar("_Item")
_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_LONG_KEY = re.compile(rf"(?<![\w.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_KEY},}}")


def check_file(file: Path, largest: int | None = None) -> None:
    """InputError where a file can't be read or is too large, and for pipes and devices, which may never end."""
    try:
        status = file.stat()
    except (OSError, ValueError) as error:  # ValueError: no file system has a name with a NUL
        raise unreadable(file, error) from None
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{file}: can't be read: it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{file}: can't be read: it is a pipe or a device; allowed are files")
    if largest is not None and status.st_size > largest:
        raise InputError(f"{file}: {status.st_size} bytes; allowed are {largest}")


def is_missing(file: str | Path) -> bool:
    """Whether a file is certainly not there: of one that may not be looked at nobody knows."""
    try:
        os.lstat(file)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except (OSError, ValueError):
        pass
    return False


def unreadable(file: Path, error: OSError | ValueError) -> InputError:
    return InputError(f"{file}: can't be read: {getattr(error, 'strerror', None) or error}")


def read_text(file: Path, largest: int = MAX_DRAWING) -> str:
    """A file of UTF-8 text. Raises InputError."""
    check_file(file, largest)
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{file}: not UTF-8 text") from None
    except OSError as error:
        raise unreadable(file, error) from None


def parse_toml(text: str) -> dict[str, Any]:
    """TOML of any text. Raises ValueError where it is none, and for what takes the parser too long or too deep."""
    if _LONG_KEY.search(text):
        raise ValueError(f"a key of more than {MAX_KEY} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def floats(text: str) -> list[float]:
    """The numbers of an attribute: 1_000 and digits of other scripts are Python's alone. Raises ValueError."""
    if "_" in text or not text.isascii():
        raise ValueError
    return [float(part) for part in text.split()]


@contextmanager
def bounded(file: Path) -> Iterator[None]:
    """While others' code unpacks `file`, this process may get MAX_UNPACKED more memory; beyond: InputError.

    A few bytes may unpack to gigabytes, and only who unpacks them knows. On Linux alone; elsewhere there is no limit.
    """
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = (limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY)
    most = min((pages * resource.getpagesize() + MAX_UNPACKED, *limits))
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    try:
        yield
    except MemoryError:
        raise InputError(f"{file}: it unpacks to more than {MAX_UNPACKED >> 20} MB, which are allowed") from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def bounded_each(file: Path, items: Iterable[_Item]) -> Iterator[_Item]:
    """The items, each made within the bounds of memory; not what their user makes of them."""
    iterator = iter(items)
    while True:
        with bounded(file):
            try:
                item = next(iterator)
            except StopIteration:
                return
        yield item


def check_records(file: Path, records: int, kept: int = 0) -> None:
    """InputError where a stream has more records than are allowed, or more numbers (`kept`) than stay in memory."""
    if records > MAX_RECORDS:
        raise InputError(
            f"{file}: {records} records; allowed are {MAX_RECORDS}. Cut the file, or keep every tenth record"
        )
    if kept > MAX_KEPT:
        raise InputError(
            f"{file}: {records} samples, {kept} numbers in all; allowed are {MAX_KEPT} numbers that stay in memory. "
            "Keep every tenth sample, leave out columns, or cut the file"
        )


class Sized(Protocol):
    """An array or a table: rows, and numbers in all."""

    @property
    def size(self) -> int: ...

    def __len__(self) -> int: ...


_Chunk = TypeVar("_Chunk", bound=Sized)


def kept(file: Path, chunks: Iterable[_Chunk]) -> Iterator[_Chunk]:
    """The chunks of a stream whose user keeps them all; InputError where they are more than fit into memory."""
    samples = numbers = 0
    for chunk in chunks:
        samples, numbers = samples + len(chunk), numbers + chunk.size
        check_records(file, samples, numbers)
        yield chunk
