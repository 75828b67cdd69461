"""Channels of a measurement as parts of a pose."""

from __future__ import annotations

from collections.abc import Iterable


def parts(channels: Iterable[str]) -> frozenset[str]:
    """An orientation is tilt and yaw."""
    return frozenset(part for c in channels for part in (("tilt", "yaw") if c == "orientation" else (c,)))


def all_turns(channels: Iterable[str]) -> bool:
    """Whether they say all of an orientation."""
    return {"tilt", "yaw"} <= parts(channels)
