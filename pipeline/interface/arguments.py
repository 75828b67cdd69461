"""Arguments of the wrong kind, refused in one line that says what is allowed."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from kincal.urdf.errors import InputError


def whole_number(name: str, value: Any) -> int:
    """An int, or a whole number of numpy's. Raises InputError."""
    if not isinstance(value, bool):
        try:
            return operator.index(value)
        except TypeError:
            pass
    raise InputError(f"{name}: found {_shown(value)}; allowed is a whole number")


def number(name: str, value: Any) -> float:
    """A float, or a number of numpy's. Raises InputError."""
    if not isinstance(value, bool | str):
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise InputError(f"{name}: found {_shown(value)}; allowed is a number")


def one_of(name: str, value: Any, allowed: Sequence[str]) -> str:
    """Raises InputError."""
    if value not in allowed:
        raise InputError(f"{name}: found {_shown(value)}; allowed are {', '.join(map(repr, allowed))}")
    return value


def path(name: str, value: Any) -> Path:
    """Raises InputError."""
    if not isinstance(value, str | PathLike):
        raise InputError(f"{name}: found {_shown(value)}; allowed is a path")
    return Path(fspath(value))  # pyright: ignore[reportUnknownArgumentType]


def observer(progress: Any) -> None:
    """Raises InputError where progress is neither True or False nor a function."""
    if not isinstance(progress, bool) and not callable(progress):
        raise InputError(f"progress: found {_shown(progress)}; allowed are True, False and a function")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"a {type(value).__name__}"
