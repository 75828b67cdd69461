"""Files that stand there whole or not at all, whatever happens meanwhile."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from kincal.urdf.errors import InputError


def write_flushed(file: Path, content: bytes) -> None:
    """Down to the disk. Raises OSError."""
    with open(file, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def replace_file(file: Path, content: bytes, aside: Path | None = None) -> None:
    """Written aside (default: beside the file), then renamed: what stood there is replaced at once. Raises OSError."""
    temporary = (aside or file.parent) / f".{file.name}.{uuid.uuid4().hex}"
    try:
        write_flushed(temporary, content)
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)


def replace_files(folder: Path, files: Mapping[str, bytes], name_of_target: str) -> None:
    """Each replaced at once, in this order; the folder is made. Raises InputError, which names `name_of_target`."""
    with refusing(name_of_target):
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            replace_file(folder / name, content)


@contextmanager
def refusing(target: str) -> Iterator[None]:
    """An OSError becomes the InputError "`target`: can't be written: why"."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{target}: can't be written: {error.strerror or error}") from None


def output_folder(output: Path | None, default: Path) -> Path:
    """Where the results go; tried before hours of work. Raises InputError."""
    folder = default if output is None else output
    with refusing(f"{'store' if output is None else '--output'} {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / ".sweep", b"")
        (folder / ".sweep").unlink(missing_ok=True)
    return folder.absolute()
