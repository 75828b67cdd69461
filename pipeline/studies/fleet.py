"""Many robots at once: `kincal run` and `compare` of several, of a folder, of a fleet file, or of all shipped ones."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kincal.pipeline.run.fan_out import Failure, Job, Outcome, portable
from kincal.pipeline.store.digests import digest
from kincal.pipeline.studies.study import Point, Study
from kincal.urdf.description import ROBOTS
from kincal.urdf.errors import InputError
from kincal.urdf.fleet import as_reference, is_unit, load, references
from kincal.urdf.input_files import is_missing


@dataclass(frozen=True)
class Selection:
    """Which robots: their references, and a name for all of them."""

    name: str
    references: tuple[str, ...]

    @property
    def folder(self) -> str:
        """In the store: two fleets of one name don't mix."""
        return f"{self.name}-{digest(list(self.references))[:10]}"


@dataclass(frozen=True)
class Member(Point):
    """A robot of the fleet."""

    reference: str  # as other commands take it

    @property
    def name(self) -> str:
        return self.label


@dataclass(frozen=True)
class Fleet:
    """What came of a fleet, member by member."""

    name: str
    study: Study[Member]
    outcomes: tuple[Outcome | Failure, ...]

    @property
    def members(self) -> tuple[Member, ...]:
        return self.study.points

    def check(self) -> None:
        """Raises InputError where all robots were bad input, CalibrationError where any failed otherwise."""
        self.study.check(self.outcomes)


def select(robots: Sequence[str] | str | os.PathLike[str] | None) -> Selection:
    """References of robots; a fleet file, or a folder of robots' folders; None: all shipped. Raises InputError."""
    if robots is None or isinstance(robots, str | os.PathLike):
        return _all(None if robots is None else Path(robots))
    if not robots:
        raise InputError("no robot: name one or more, or --all")
    wrong = next((robot for robot in robots if not isinstance(robot, str | os.PathLike)), None)
    if wrong is not None:
        raise InputError(f"robots: found a {type(wrong).__name__}; allowed are names, paths, and FLEET.toml:UNIT")
    robots = [os.fspath(robot) for robot in robots]
    resolved = [as_reference(robot) for robot in robots]
    repeated = next((r for r, f in zip(robots, resolved, strict=True) if resolved.count(f) > 1), None)
    if repeated is not None:
        raise InputError(f"robot {repeated!r} appears twice")
    return Selection("robots", tuple(resolved))


def _all(source: Path | None) -> Selection:
    folder = ROBOTS if source is None else source.absolute()
    if folder.is_file():
        return Selection(folder.stem, tuple(references(folder)))
    # One that may not be looked into fails later, by a row of its own.
    robots = sorted(str(file) for part in folder.glob("*/") if not is_missing(file := part / "robot.toml"))
    if not robots:
        raise InputError(f"--from {source}: neither a fleet file nor a folder of robots' folders, each with robot.toml")
    return Selection(folder.name, tuple(robots))


def plan_fleet(chosen: Selection, overrides: Sequence[str], store: Path, until: str, command: str) -> Study[Member]:
    """Raises InputError where there is no valid robot at all."""
    members, shared = [], portable(overrides)
    for reference in chosen.references:
        job = Job(reference, shared, store.absolute(), until, command, noted=True)
        try:
            robot = load(reference, shared).description
        except InputError as error:
            name = reference.rpartition(":")[2] if is_unit(reference) else reference
            members.append(Member(name, job, error, reference))
        else:
            members.append(Member(robot.name, job, robot, reference))
    return Study(tuple(members), "robots")
