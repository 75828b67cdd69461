"""Robots by reference: a name, a path, or a unit of a fleet file (`fleet_file.py`), FLEET.toml:UNIT."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kincal.urdf.description import Robot, as_absolute, find_robot, load_robot, read_toml
from kincal.urdf.errors import InputError


def load(reference: str, overrides: Sequence[str] = ()) -> Robot:
    """A robot, as load_robot takes it; or FLEET.toml:UNIT. Raises InputError.

    overrides: go over the unit's own settings, which go over the fleet's, which go over robot.toml's.
    """
    if is_unit(reference):
        from kincal.urdf.fleet_file import unit_of

        file, _, unit = reference.rpartition(":")
        return _reopenable(unit_of(Path(file).absolute(), unit, overrides), reference, overrides)
    try:
        return _reopenable(load_robot(reference, overrides), reference, overrides)
    except InputError:
        if reference.endswith(".toml") and os.path.isfile(reference) and "design" in read_toml(Path(reference)):
            which = f"--all --from {reference}, or one unit, {reference}:NAME"
            raise InputError(f"{reference}: a fleet, not a robot: {which}") from None
        raise


def _reopenable(robot: Robot, reference: str, overrides: Sequence[str]) -> Robot:
    """With what opens it again, from any folder."""
    return replace(robot, reference=as_reference(reference), overrides=tuple(map(as_absolute, overrides)))


def is_unit(reference: str) -> bool:
    file, _, _ = reference.rpartition(":")
    return bool(file) and not os.path.exists(reference) and os.path.isfile(file)  # quiet about names that can't be


def as_reference(robot: str) -> str:
    """The same robot, for a process in another folder. Raises InputError."""
    if is_unit(robot):
        return str(Path(robot).absolute())
    return str(find_robot(robot))


def references(file: Path) -> list[str]:
    """FLEET.toml:UNIT of every unit. Raises InputError."""
    from kincal.urdf.fleet_file import read_fleet

    return [f"{file}:{name}" for name in read_fleet(file).all_units]
