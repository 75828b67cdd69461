"""Fleets: many units built to one drawing, in one file; each is a robot like any other.

design = "ups3_s"                 # a robot's name, or a path relative to this file
units = 24                        # virtual ones: unit_00 .. unit_23, with measure.seed 0 .. 23
[set]                             # settings of all units, as of --set
"identify.estimator" = "map"
[[unit]]                          # or one by one
name = "hull_07"
seed = 7                          # measure.seed of a virtual one
set = { "measure.table" = "hull_08.csv" }
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from kincal.urdf.description import (
    Name,
    Robot,
    Seed,
    Setting,
    described,
    find_robot,
    nearest,
    parse_override,
    relative_to,
    toml_of,
    toml_text,
    validate,
)
from kincal.urdf.errors import InputError, quoted

MOST_UNITS = 10_000
_DEEPEST = 10  # tables in tables


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Unit(_Table):
    name: Name
    seed: Seed | None = None  # measure.seed of a virtual unit
    set: dict[str, Any] = {}


class Fleet(_Table):
    design: str
    set: dict[str, Any] = {}
    units: Annotated[int, Field(ge=1, le=MOST_UNITS)] | None = None
    unit: Annotated[tuple[Unit, ...], Field(strict=False, max_length=MOST_UNITS)] = ()

    @model_validator(mode="after")
    def _named(self) -> Fleet:
        if (self.units is None) == (not self.unit):
            raise ValueError("give units = N (virtual ones), or one [[unit]] each")
        seen: set[str] = set()
        for unit in self.unit:
            if unit.name in seen:
                raise ValueError(f"unit: {quoted(unit.name)} appears twice")
            seen.add(unit.name)
        return self

    @property
    def all_units(self) -> dict[str, Unit]:
        if self.units is None:
            return {unit.name: unit for unit in self.unit}
        digits = max(2, len(str(self.units - 1)))
        numbered = (Unit(name=f"unit_{k:0{digits}d}", seed=k) for k in range(self.units))
        return {unit.name: unit for unit in numbered}


def read_fleet(file: Path) -> Fleet:
    """Raises InputError, naming the file, the field, what was found and what is allowed."""
    return _fleet(toml_text(file), str(file))


def unit_of(file: Path, name: str, overrides: Sequence[str]) -> Robot:
    fleet, units = _units(toml_text(file), str(file))
    if name not in units:
        raise InputError(f"{file}: no unit {quoted(name)}; {nearest(name, units)}")
    unit, where = units[name], f"{file}: unit {name}"
    shipped = "/" not in fleet.design and not (file.parent / fleet.design).exists()
    try:
        design = find_robot(fleet.design if shipped else str(file.parent / fleet.design))
    except InputError as error:
        raise InputError(f"{file}: design: {error}") from None
    settings = [Setting(("name",), name, where)]
    seed = {} if unit.seed is None else {"measure.seed": unit.seed}
    for table, origin in ((fleet.set, f"{file}: set"), (seed, f"{where}: seed"), (unit.set, f"{where}: set")):
        for keys, value in _leaves(table, origin):
            if keys == ("name",):
                raise InputError(f"{origin}: name: a unit's name is the one of [[unit]]")
            settings.append(Setting(keys, relative_to(file.parent, keys, value), origin))
    return Robot(design, described(design, [*settings, *map(parse_override, overrides)]), fleet=file)


def _leaves(
    table: Mapping[str, Any], origin: str, before: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """{"a.b": 1, c: {d: 2}} -> (a, b) 1, (c, d) 2: a table changes the keys that it has, the others stay."""
    for key, value in table.items():
        keys = (*before, *(part.strip() for part in key.split(".")))
        if len(keys) > _DEEPEST:
            raise InputError(f"{origin}: {'.'.join(keys[:3])}...: nested too deeply")
        if isinstance(value, dict):
            yield from _leaves(value, origin, keys)
        else:
            yield keys, value


@lru_cache(maxsize=4)
def _fleet(text: str, where: str) -> Fleet:
    return validate(Fleet, toml_of(text, where), where)


@lru_cache(maxsize=4)
def _units(text: str, where: str) -> tuple[Fleet, dict[str, Unit]]:
    """A file of many units is read once a unit, and taken apart once."""
    fleet = _fleet(text, where)
    return fleet, fleet.all_units
