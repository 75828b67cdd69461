"""The kinds of measurement. A new one is a file beside this one, a place in CHANNELS, and a line in SENSORS.

`channel.Channel` says what a file must hold; `urdf.description.SENSORS` is what robot.toml may say of sensors.
"""

from __future__ import annotations

from collections.abc import Iterable

from kincal.identification.channels.channel import Channel
from kincal.identification.channels.orientation import ORIENTATION
from kincal.identification.channels.position import POSITION
from kincal.identification.channels.tilt import TILT
from kincal.identification.channels.yaw import YAW

CHANNELS: tuple[Channel, ...] = (ORIENTATION, POSITION, TILT, YAW)  # in the order of a table's columns
BY_ROWS = tuple(sorted(CHANNELS, key=lambda c: c.unit == "m"))  # in the order of a pose's residuals: angles first


def named(names: Iterable[str]) -> tuple[Channel, ...]:
    """The channels of these names, in their order."""
    by_name = {c.name: c for c in CHANNELS}
    return tuple(by_name[name] for name in names)


def parts(names: Iterable[str]) -> frozenset[str]:
    """What of a pose these channels measure: an orientation is tilt and yaw."""
    return frozenset(part for c in named(names) for part in c.parts)


def all_turns(names: Iterable[str]) -> bool:
    """Whether they say all of an orientation."""
    return ORIENTATION.parts <= parts(names)


def merged(names: Iterable[str]) -> tuple[Channel, ...]:
    """The channels in the order of residuals, with tilt and yaw as the orientation that they are together."""
    left, chosen = parts(names), set()
    for channel in CHANNELS:
        if channel.parts <= left:
            left, chosen = left - channel.parts, chosen | {channel}
    return tuple(c for c in BY_ROWS if c in chosen)


def scored(names: Iterable[str]) -> dict[str, Channel]:
    """{unit: the channel whose error a prediction is judged by}; a unit that nothing measures is not there."""
    by_unit: dict[str, Channel] = {}
    for channel in merged(names):
        if channel.scored:
            by_unit.setdefault(channel.unit, channel)
    return by_unit
