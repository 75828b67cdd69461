"""A study: points, each with a job; the jobs on workers; what came of each. Rows and files are each study's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from kincal.pipeline.run.executor import Place, executor
from kincal.pipeline.run.fan_out import Failure, Job, Observe, Outcome, files_of, run_all
from kincal.pipeline.run.workers import JobExecutor
from kincal.urdf.description import RobotDescription
from kincal.urdf.errors import CalibrationError, InputError


@dataclass(frozen=True)
class Point:
    """One job of a study, its name for people, and its robot; or why there is none."""

    label: str
    job: Job
    robot: RobotDescription | InputError


_Point = TypeVar("_Point", bound=Point)


@dataclass(frozen=True)
class Study(Generic[_Point]):
    """All points. Raises InputError where none of them has a valid robot."""

    points: tuple[_Point, ...]
    noun: str = "jobs"

    def __post_init__(self) -> None:
        bad = [point.robot for point in self.points if isinstance(point.robot, InputError)]
        if bad and len(bad) == len(self.points):
            raise bad[0]

    @property
    def labels(self) -> dict[Job, str]:
        """Of the jobs that will run."""
        return {point.job: point.label for point in self.points if isinstance(point.robot, RobotDescription)}

    @contextmanager
    def carried_out(self, on: Place, observe: Observe) -> Iterator[tuple[JobExecutor, list[Outcome | Failure]]]:
        """The workers, and what came of each point. A job that fails leaves the others.

        What is neither bad input nor a failed check is raised.
        """
        valid = {point.job: point.robot for point in self.points if isinstance(point.robot, RobotDescription)}
        jobs, robots = list(valid), list(valid.values())
        with executor(on, jobs[0].store, files_of(jobs, robots)) as workers:
            by_job = dict(zip(jobs, run_all(jobs, robots, workers, observe), strict=True))
            yield (
                workers,
                [
                    Failure(point.robot) if isinstance(point.robot, InputError) else by_job[point.job]
                    for point in self.points
                ],
            )

    def run(self, on: Place, observe: Observe) -> list[Outcome | Failure]:
        """What came of each point."""
        with self.carried_out(on, observe) as (_, outcomes):
            return outcomes

    def check(self, outcomes: Sequence[Outcome | Failure]) -> None:
        """Raises InputError where all points were bad input, CalibrationError where any failed otherwise."""
        pairs = zip(self.points, outcomes, strict=True)
        failed = [(point, outcome.error) for point, outcome in pairs if isinstance(outcome, Failure)]
        if not failed:
            return
        (point, error), n = failed[0], len(self.points)
        bad = len(failed) == n and all(isinstance(error, InputError) for _, error in failed)
        message = f"{len(failed)} of {n} {self.noun} failed, the first ({point.label}): {error}"
        raise (InputError if bad else CalibrationError)(message)
