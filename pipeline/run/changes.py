"""What a stage's key is made of, compared with last time: the reason why it runs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kincal.pipeline.store.digests import digest
from kincal.urdf.errors import InputError
from kincal.urdf.input_files import check_file

_LONGEST = 100  # letters of a changed value that are shown

FIRST = "never ran for this robot"


def explain(last: Mapping[str, Any] | None, parts: Mapping[str, Any]) -> str:
    """Why a stage runs: the difference of what its key was made of last time and now."""
    if last is None:
        return FIRST
    if not last:
        return "its artifact is gone or damaged"
    return change(last.get("parts", {}), parts) or "its artifact is gone or damaged"


def change(before: Mapping[str, Any], parts: Mapping[str, Any]) -> str | None:
    """The first difference of what two keys were made of; None: there is none."""
    for group, label in (
        ("settings", "setting"),
        ("files", "file"),
        ("inputs", "input"),
        ("code", "code"),
        ("libraries", "library"),
    ):
        old, new = _flat(before.get(group, {})), _flat(parts[group])
        changed = [name for name in {**old, **new} if old.get(name) != new.get(name)]
        if changed:
            more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
            shown = group in ("settings", "libraries")
            detail = _change(changed[0], old.get(changed[0]), new.get(changed[0])) if shown else "changed"
            return f"{label} {changed[0]} {detail}{more}"
    return None


def _change(key: str, old: Any, new: Any) -> str:
    """`old -> new`; of tables with names which ones, and of anything long only that it changed."""
    tables = [part for value in (old, new) if isinstance(value, list) for part in value]
    if tables and all(isinstance(part, Mapping) and "name" in part for part in tables):
        names = dict.fromkeys(part["name"] for part in tables if part not in (old or []) or part not in (new or []))
        return f"changed ({key.rpartition('.')[2]} {', '.join(map(repr, names)) or 'order'})"
    text = f"{old} -> {new}"
    return text if len(text) <= _LONGEST else "changed"


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, Mapping):
        return {prefix: value}
    return {
        k: v for name, part in value.items() for k, v in _flat(part, f"{prefix}.{name}" if prefix else name).items()
    }


def file_digest(file: Path) -> str:
    """Of a file's content, read piece by piece; of a folder (a ROS 2 bag), of its files' names and contents."""
    try:
        if file.is_dir():
            return digest({part.name: file_digest(part) for part in sorted(file.iterdir()) if part.is_file()})
        check_file(file)
        with open(file, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file}: can't be read: {error.strerror}") from None
