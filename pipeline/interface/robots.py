"""Robots by name, by path, or from a fleet file, with settings over those of their robot.toml."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from kincal.urdf.description import Robot
from kincal.urdf.errors import InputError
from kincal.urdf.toml_values import as_toml

if TYPE_CHECKING:
    from kincal.urdf.proposed_toml import Written

RobotLike: TypeAlias = "Robot | str | PathLike[str]"
Settings: TypeAlias = "Mapping[str, Any] | tuple[str, ...] | list[str]"


def load(robot: str | PathLike[str], settings: Settings = ()) -> Robot:
    """Read a robot and check its description.

    Parameters
    ----------
    robot
        The name of a shipped robot, the path to a robot.toml or to its folder, or `FLEET.toml:UNIT`.
    settings
        Values that replace those of robot.toml: `{"plan.poses": 60}`, or texts as after `--set` of the command line.
        Paths are relative to the current folder.

    Returns
    -------
    Robot
        An immutable value. `description` holds every setting, `file` is the robot.toml.

    Raises
    ------
    InputError
        The message names the file, the field, what was found and what is allowed.

    Examples
    --------
    >>> import kincal
    >>> robot = kincal.load("ups3_s", {"plan.poses": 60, "seed": 1})
    >>> robot.description.plan.poses
    60
    """
    from kincal.urdf import fleet

    if not isinstance(robot, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError(f"robot: found a {type(robot).__name__}; allowed are a name, a path, or FLEET.toml:UNIT")
    return fleet.load(fspath(robot), overrides_of(settings))


def propose(drawing: str | PathLike[str], output: str | PathLike[str] | None = None) -> Written:
    """Propose a robot.toml for a drawing, to be read and corrected: loops, actuators and a workspace.

    Parameters
    ----------
    drawing
        The URDF or MJCF file.
    output
        The file to write, which must not exist. Default: robot.toml beside the drawing.

    Returns
    -------
    Written
        `file`, a `summary`, and `remarks` on what to look at.

    Raises
    ------
    InputError
        The drawing can't be read, or the output exists or can't be written.

    Examples
    --------
    >>> import kincal
    >>> kincal.propose("no_such_robot.urdf")
    Traceback (most recent call last):
    kincal.urdf.errors.InputError: no_such_robot.urdf: can't be read: No such file or directory
    """
    from kincal.urdf.proposed_toml import write_proposal

    return write_proposal(Path(drawing), None if output is None else Path(output))


def robot_schema() -> dict[str, Any]:
    """Return the JSON Schema of robot.toml, as `kincal schema` prints it.

    Returns
    -------
    dict
        A JSON Schema, draft 2020-12. Checks across fields, such as names of joints, are left to `load`.

    Examples
    --------
    >>> import kincal
    >>> kincal.robot_schema()["$id"]
    'kincal-robot-1'
    """
    from kincal.urdf.schema import robot_schema

    return robot_schema()


def write_schema(output: str | PathLike[str]) -> Path:
    """Write the JSON Schema of robot.toml to a file. Raises InputError where that can't be written."""
    import json

    from kincal.pipeline.store.files import refusing, replace_file

    file = Path(output)
    with refusing(f"schema {file}"):
        replace_file(file, (json.dumps(robot_schema(), indent=2) + "\n").encode())
    return file


def robot_of(robot: RobotLike, settings: Settings = ()) -> Robot:
    """A robot that may be loaded already, with more settings. Raises InputError as `load` does."""
    if not isinstance(robot, Robot):
        return load(robot, settings)
    if not settings:
        return robot
    return load(robot.reference, (*robot.overrides, *overrides_of(settings)))


def overrides_of(settings: Settings) -> tuple[str, ...]:
    """`table.key=value` in TOML syntax, one a setting. Raises InputError."""
    if isinstance(settings, Mapping):
        return tuple(f"{key}={as_toml(value, key)}" for key, value in _leaves(settings, ""))
    texts: list[Any] = [settings] if isinstance(settings, str) else list(settings)
    if isinstance(settings, str) or not all(isinstance(text, str) for text in texts):
        raise InputError('settings: allowed are a dictionary, {"plan.poses": 60}, or texts, ["plan.poses=60"]')
    return tuple(texts)


def _leaves(settings: Mapping[str, Any], before: str) -> Iterator[tuple[str, Any]]:
    """{"plan": {"poses": 60}} is {"plan.poses": 60}."""
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(cast("Mapping[str, Any]", value), f"{before}{key}.")
        else:
            yield f"{before}{key}", value
