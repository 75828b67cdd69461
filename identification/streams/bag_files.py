"""What a bag's files must not be: pipes, databases that are programs, metadata that refers to itself."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

from kincal.urdf.errors import InputError, quoted, shortened
from kincal.urdf.input_files import check_file

MAX_METADATA = 1 << 20  # bytes of metadata.yaml
_ANCHOR = re.compile(rb"(?:^|[\s\[{,:-])[&*][^\s&*]", re.MULTILINE)  # of YAML: a few lines can stand for gigabytes
_PLAIN = re.compile(r"\s*CREATE\s+(TABLE|INDEX|UNIQUE\s+INDEX)\b", re.IGNORECASE)
_COMPUTED = re.compile(r"\bAS\b", re.IGNORECASE)  # generated columns, tables made of a query


def check_bag(bag: Path) -> None:
    """Raises InputError where reading a bag, a file or a folder, might never end. What it says is not looked at."""
    files = sorted(bag.iterdir()) if bag.is_dir() else [bag]
    for file in files:
        check_file(file, MAX_METADATA if file.name == "metadata.yaml" else None)
        if file.name == "metadata.yaml" and _ANCHOR.search(file.read_bytes()):
            raise InputError(f"{file}: it has YAML anchors; allowed is metadata without")
        with open(file, "rb") as stream:
            if stream.read(16) == b"SQLite format 3\0":
                _check_database(file)


def _check_database(file: Path) -> None:
    """A view or a computed column can be a query without end."""
    try:
        with closing(database_of(file)) as database:
            tables = database.execute("select name, sql from sqlite_master where sql is not null limit 1000").fetchall()
    except (sqlite3.Error, ValueError, OverflowError) as error:
        raise InputError(f"{file}: not a database that can be read: {shortened(error)}") from None
    for name, sql in tables:
        if not _PLAIN.match(str(sql)) or _COMPUTED.search(str(sql)):
            raise InputError(f"{file}: {quoted(str(name))} is no plain table or index, which are allowed")


def database_of(file: Path) -> sqlite3.Connection:
    """For reading alone; of a file that was cut, what is left. Raises sqlite3.Error, ValueError, OverflowError."""
    database = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    database.execute("pragma writable_schema = on")  # without, a file shorter than its header says is not read at all
    return database
