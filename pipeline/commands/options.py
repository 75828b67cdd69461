"""What the commands have in common: their options, and the robot that they open."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kincal.pipeline.commands.console import Progress
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.pipeline.run.runner import Run

Robot = Annotated[str, Parameter(help="A shipped robot's name, the path to a robot.toml, or FLEET.toml:UNIT.")]
Flag = Annotated[bool, Parameter(negative=())]
All = Annotated[bool, Parameter(name="--all", negative=(), help="All shipped robots, or all of --from.")]
From = Annotated[Path | None, Parameter(name="--from", help="A fleet file, or a folder of robots' folders.")]
On = Annotated[str, Parameter(help="How many worker processes (1: this process), or dask://host:port.")]
Json = Annotated[bool, Parameter(name="--json", negative=(), help="One JSON document on stdout.")]
JsonInstead = Annotated[Json, Parameter(help="One JSON document on stdout instead.")]


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options that every command has."""

    set: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None
    """Override one value of robot.toml: table.key=value, in TOML syntax; may be repeated."""
    store: Path = Path(".kincal")
    """The folder of cached artifacts."""

    @property
    def overrides(self) -> tuple[str, ...]:
        return tuple(self.set or ())


COMMON = Common()


def opened(robot: str, common: Common, force_from: str | None = None) -> Run:
    """The robot's way through the stages, which says on stderr how far it is. Raises InputError."""
    from kincal.pipeline.run.runner import Run
    from kincal.pipeline.run.stage import all_stages
    from kincal.pipeline.store.store import Store
    from kincal.urdf.description import nearest
    from kincal.urdf.fleet import load

    if force_from is not None and force_from not in all_stages():
        raise InputError(f"--force-from {force_from}: no such stage; {nearest(force_from, all_stages())}")
    loaded = load(robot, common.overrides)
    return Run(loaded, Store(common.store), force_from, Progress(loaded.description.name), command_line())


def command_line() -> str:
    return shlex.join(["kincal", *sys.argv[1:]])
