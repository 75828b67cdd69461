"""What the commands have in common: their options, and the robot that they open."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from kincal.pipeline.interface.calibration import Calibration

Robot = Annotated[str, Parameter(help="A shipped robot's name, the path to a robot.toml, or FLEET.toml:UNIT.")]
Flag = Annotated[bool, Parameter(negative=())]
All = Annotated[bool, Parameter(name="--all", negative=(), help="All shipped robots, or all of --from.")]
From = Annotated[Path | None, Parameter(name="--from", help="A fleet file, or a folder of robots' folders.")]
On = Annotated[
    str, Parameter(help="How many worker processes (1: this process), dask://host:port, or tls://host:port.")
]
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


def opened(robot: str, common: Common, force_from: str | None = None) -> Calibration:
    """The robot, with progress on stderr. Raises InputError."""
    from kincal.pipeline.interface.calibration import Calibration
    from kincal.pipeline.interface.robots import load

    loaded = load(robot, common.overrides)
    return Calibration.open(loaded, store=common.store, progress=True, command=command_line(), force_from=force_from)


def command_line() -> str:
    return shlex.join(["kincal", *sys.argv[1:]])
