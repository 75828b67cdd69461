"""Python values in TOML syntax."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from kincal.urdf.errors import InputError, quoted


def as_toml(value: Any, name: str) -> str:
    """A number, a text, a truth value, a path, a numpy value, or a list or dictionary of these.

    Raises InputError, which begins with `name`, for anything else.
    """
    import tomlkit

    try:
        return tomlkit.item(_plain(value)).as_string()
    except (ValueError, TypeError):
        allowed = "a number, a text, true or false, or a list of these"
        raise InputError(f"settings: {name}: found {quoted(value)}; allowed is {allowed}") from None


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy's
        return value.tolist()
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, dict):
        import tomlkit

        table = tomlkit.inline_table()
        table.update({key: _plain(part) for key, part in value.items()})
        return table
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value
