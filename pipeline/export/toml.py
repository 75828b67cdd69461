"""The robot.toml of an exported robot: its source's own text, comments and all, with other values where they differ."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from kincal.urdf.description import PATHS, RobotDescription


def exported_toml(description: RobotDescription, source: Path, folder: Path, remarks: Sequence[str]) -> str:
    """`description` as a file in `folder`, in the words of `source`, the file it was read from.

    Relative paths are made relative to `folder`, absolute ones stay. said: comments for its first lines.
    """
    before = _parsed(source)
    wanted = _plain(description.model_dump(exclude_unset=True, exclude_none=True, by_alias=True))
    _shorten_columns(wanted)
    for tables, key in ((path[:-1], path[-1]) for path in PATHS):
        here = _at(wanted, tables)
        if here is not None and key in here and not _is_absolute(before, (*tables, key)):
            here[key] = _relative(Path(here[key]), folder)
    wanted["urdf"] = description.urdf.name
    comments = "".join(f"# {_one_line(text)}\n" for text in remarks)
    text = comments + tomlkit.dumps(_edited(before, wanted))
    if not _says(text, wanted):  # a layout that tomlkit can't edit: without its comments then
        text = comments + tomlkit.dumps(wanted)
    return text


def _parsed(source: Path) -> tomlkit.TOMLDocument:
    try:
        return tomlkit.parse(source.read_text(encoding="utf-8"))
    except (OSError, ValueError, TOMLKitError):  # gone since it was read, or nothing that tomlkit understands
        return tomlkit.document()


def _edited(document: tomlkit.TOMLDocument, wanted: Mapping[str, Any]) -> tomlkit.TOMLDocument:
    try:
        _edit(document, wanted)
    except (TOMLKitError, ValueError, KeyError, TypeError):
        return tomlkit.document()
    return document


def _edit(table: Any, wanted: Mapping[str, Any]) -> None:
    """Make a table of a document say what is wanted; what says it already is not touched."""
    for key in [key for key in table if key not in wanted]:
        del table[key]
    for key, value in wanted.items():
        old = table.get(key)
        if old == value:
            continue
        if isinstance(old, dict) and isinstance(value, dict):
            _edit(old, value)
        elif _are_tables(old) and _are_tables(value) and len(old) == len(value):
            for item, new in zip(old, value, strict=True):
                _edit(item, new)
        else:
            table[key] = value


def _are_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)


def _says(text: str, wanted: Mapping[str, Any]) -> bool:
    try:
        return tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _plain(value: Any) -> Any:
    """A value in TOML's own types."""
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


def _shorten_columns(wanted: dict[str, Any]) -> None:
    """{ from = "x" } is written "x"."""
    columns = wanted.get("measure", {}).get("columns", {})
    for name, column in columns.items():
        if set(column) == {"from"}:
            columns[name] = column["from"]


def _at(content: Any, tables: Sequence[str]) -> Any:
    for name in tables:
        content = content.get(name) if isinstance(content, Mapping) else None
    return content if isinstance(content, Mapping) else None


def _is_absolute(document: Mapping[str, Any], keys: Sequence[str]) -> bool:
    """Whether the source says this path, and says it in full."""
    table = _at(document, keys[:-1])
    value = None if table is None else table.get(keys[-1])
    return isinstance(value, str) and Path(value).is_absolute()


def _relative(file: Path, folder: Path) -> str:
    """`file` as seen from `folder`, links in the way resolved (a link's own name says what the file is)."""
    return Path(os.path.relpath(file.parent.resolve() / file.name, folder.resolve())).as_posix()


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)
