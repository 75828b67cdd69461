"""Many robots at once: `kincal run` and `compare` of several, of a folder, of a fleet file, or of all shipped ones."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kincal.pipeline.run.executor import Place, executor
from kincal.pipeline.run.fan_out import Failure, Job, Observe, Outcome, files_of, portable, run_all
from kincal.pipeline.store.digests import digest
from kincal.urdf.description import ROBOTS, Robot
from kincal.urdf.errors import CalibrationError, InputError
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
class Member:
    """A robot of the fleet, and its job; or why it can't have one."""

    reference: str  # as other commands take it
    job: Job
    robot: Robot | InputError

    @property
    def name(self) -> str:
        if isinstance(self.robot, InputError):
            return self.reference.rpartition(":")[2] if is_unit(self.reference) else self.reference
        return self.robot.description.name


@dataclass(frozen=True)
class Carried:
    """What came of a fleet, member by member."""

    name: str
    members: tuple[Member, ...]
    outcomes: tuple[Outcome | Failure, ...]

    def check(self) -> None:
        """Raises InputError where all robots were bad input, CalibrationError where any failed otherwise."""
        pairs = zip(self.members, self.outcomes, strict=True)
        failed = [(member, came.error) for member, came in pairs if isinstance(came, Failure)]
        if not failed:
            return
        (member, error), n = failed[0], len(self.members)
        bad = len(failed) == n and all(isinstance(error, InputError) for _, error in failed)
        said = f"{len(failed)} of {n} robots failed, the first ({member.name}): {error}"
        raise (InputError if bad else CalibrationError)(said)


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
    found = [as_reference(robot) for robot in robots]
    repeated = next((r for r, f in zip(robots, found, strict=True) if found.count(f) > 1), None)
    if repeated is not None:
        raise InputError(f"robot {repeated!r} stands there twice")
    return Selection("robots", tuple(found))


def _all(source: Path | None) -> Selection:
    folder = ROBOTS if source is None else source.absolute()
    if folder.is_file():
        return Selection(folder.stem, tuple(references(folder)))
    # One that may not be looked into fails later, by a row of its own.
    found = sorted(str(file) for part in folder.glob("*/") if not is_missing(file := part / "robot.toml"))
    if not found:
        raise InputError(f"--from {source}: neither a fleet file nor a folder of robots' folders, each with robot.toml")
    return Selection(folder.name, tuple(found))


def plan_fleet(chosen: Selection, overrides: Sequence[str], store: Path, until: str, command: str) -> list[Member]:
    """Raises InputError where there is no valid robot at all."""
    members, shared = [], portable(overrides)
    for reference in chosen.references:
        job = Job(reference, shared, store.absolute(), until, command, noted=True)
        try:
            robot: Robot | InputError = load(reference, shared)
        except InputError as error:
            robot = error
        members.append(Member(reference, job, robot))
    bad = members[0].robot
    if isinstance(bad, InputError) and all(isinstance(m.robot, InputError) for m in members):
        raise bad
    return members


def carry_all(name: str, members: Sequence[Member], on: Place, observe: Observe) -> Carried:
    """All jobs, on these workers; a robot that fails leaves the others."""
    valid = [(m, m.robot.description) for m in members if isinstance(m.robot, Robot)]
    jobs, robots = [m.job for m, _ in valid], [robot for _, robot in valid]
    with executor(on, jobs[0].store, files_of(jobs, robots)) as workers:
        came = iter(run_all(jobs, robots, workers, observe))
    outcomes = (next(came) if isinstance(m.robot, Robot) else Failure(m.robot) for m in members)
    return Carried(name, tuple(members), tuple(outcomes))
