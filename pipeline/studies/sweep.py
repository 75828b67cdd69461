"""`kincal sweep`: one robot over a grid of settings and seeds, as one tidy table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.run.executor import Place
from kincal.pipeline.run.fan_out import Failure, Job, Observe, Outcome, portable
from kincal.pipeline.studies.grid import Over, combinations
from kincal.pipeline.studies.rows import METHOD_NUMBERS, method_rows
from kincal.pipeline.studies.study import Point, Study
from kincal.urdf.description import Robot, RobotDescription
from kincal.urdf.errors import InputError
from kincal.urdf.fleet import load

if TYPE_CHECKING:
    import pandas as pd

MOST_SEEDS = 10_000


@dataclass(frozen=True)
class SweepPoint(Point):
    """The values of the swept keys, and the robot that they make."""

    values: Mapping[str, Any]


@dataclass(frozen=True)
class Sweep:
    """A grid and its jobs; and, once they have run, their table."""

    robot: str
    overs: tuple[Over, ...]
    study: Study[SweepPoint]
    outcomes: tuple[Outcome | Failure, ...]
    table: pd.DataFrame  # one row a job and method; one row a job that failed

    @property
    def keys(self) -> list[str]:
        """Of the grid, the seed aside: results are summed up over it."""
        return [over.key for over in self.overs if over.key != "seed"]

    @property
    def n_failed(self) -> int:
        return sum(isinstance(outcome, Failure) for outcome in self.outcomes)

    def check(self) -> None:
        """Raises InputError where all jobs were bad input, CalibrationError where any failed otherwise."""
        self.study.check(self.outcomes)


def plan_sweep(
    robot: Robot, over: Sequence[Over], seeds: int, store: Path, command: str = ""
) -> tuple[tuple[Over, ...], Study[SweepPoint]]:
    """The grid and its jobs. Raises InputError, also where no job has a valid robot."""
    if not 1 <= seeds <= MOST_SEEDS:
        raise InputError(f"--seeds {seeds}: allowed are 1 (the robot's own) to {MOST_SEEDS}")
    overs = tuple(over)
    if seeds > 1:
        overs = (*overs, Over("seed", tuple(map(str, range(seeds)))))
    if not overs:
        raise InputError("nothing to sweep: give --over table.key=value,value,... or --seeds of 2 or more")
    points = []
    for places in combinations(overs):
        overrides = tuple(o.overrides()[k] for o, k in zip(overs, places, strict=True))
        values = {o.key: o.values[k] for o, k in zip(overs, places, strict=True)}
        job = Job(robot.reference, (*robot.overrides, *portable(overrides)), store.absolute(), "evaluate", command)
        label = ", ".join(f"{key}={value}" for key, value in values.items())
        points.append(SweepPoint(label, job, _loaded(job, overrides), values))
    return overs, Study(tuple(points))


def _loaded(job: Job, overrides: Sequence[str]) -> RobotDescription | InputError:
    try:
        return load(job.robot, job.overrides).description
    except InputError as error:
        message = str(error)
        for override in overrides:  # as it was written
            message = message.replace(f"--set {override}", f"--over {override}")
        return InputError(message)


def sweep(robot: str, overs: tuple[Over, ...], study: Study[SweepPoint], on: Place, observe: Observe) -> Sweep:
    """All jobs, on these workers. A job that fails is a row; what is neither bad input nor a failed check is raised."""
    outcomes = study.run(on, observe)
    rows = [row for pair in zip(study.points, outcomes, strict=True) for row in _rows(*pair)]
    return Sweep(robot, overs, study, tuple(outcomes), _frame(robot, overs, rows))


def _rows(point: SweepPoint, outcome: Outcome | Failure) -> list[dict[str, Any]]:
    seed = point.robot.seed if isinstance(point.robot, RobotDescription) else None
    columns = {"seed": seed} | dict(point.values)
    if isinstance(outcome, Failure):
        return [columns | {"error": str(outcome.error)}]
    assert outcome.comparison is not None
    return [columns | row for row in method_rows(outcome.comparison)]


def _frame(robot: str, overs: Sequence[Over], rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Columns of one type each, whatever failed: the same sweep gives the same bytes."""
    import pandas as pd

    table = pd.DataFrame({"robot": [robot] * len(rows)})
    texts = {over.key: dict(zip(map(repr, over.values), over.texts, strict=True)) for over in overs}
    for key in ("seed", *(over.key for over in overs if over.key != "seed")):
        values = [row[key] for row in rows]
        if all(isinstance(v, int) and not isinstance(v, bool) for v in values if v is not None):
            table[key] = pd.array(values, dtype="Int64")
        elif all(isinstance(v, int | float) and not isinstance(v, bool) for v in values if v is not None):
            table[key] = pd.array(values, dtype="Float64")
        elif all(isinstance(v, bool | None) for v in values):
            table[key] = pd.array(values, dtype="boolean")
        else:  # strings, and lists or tables as they were written
            table[key] = pd.array([v if isinstance(v, str) else texts[key][repr(v)] for v in values], dtype="string")
    for column in ("method", "scored_on"):
        table[column] = pd.array([row.get(column) for row in rows], dtype="string")
    table["n_poses"] = pd.array([row.get("n_poses") for row in rows], dtype="Int64")
    for column in METHOD_NUMBERS:
        table[column] = pd.array([row.get(column) for row in rows], dtype="Float64")
    table["error"] = pd.array([row.get("error") for row in rows], dtype="string")
    return table
