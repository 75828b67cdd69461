"""`kincal reproduce`: the jobs of Xu, Tian and Zhang's simulation (2024), run through the cache, and their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal.identification.channels import all_turns
from kincal.pipeline.reproduce.pose_errors import PoseErrors, errors_of
from kincal.pipeline.results import MethodScore
from kincal.pipeline.run.executor import Place
from kincal.pipeline.run.fan_out import Job, Observe, Outcome, portable
from kincal.pipeline.studies.study import Point as JobPoint
from kincal.pipeline.studies.study import Study as JobStudy
from kincal.urdf.description import RobotDescription, load_robot
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

ROBOT = "ups3_s"
MOST_SEEDS = 200
_OWN = (
    "seed",
    "measure.seed",
    "plan",
    "split",
    "pretrain.hidden",
    "prior.poses",
    "evaluate.closed_loop",
)  # what the study chooses
Row = Mapping[str, Any]
_INDICES = ("mean", "max", "sd", "x", "y", "z")


@dataclass(frozen=True)
class Study:
    """What is run. The defaults are the paper's, and its outlook's."""

    seeds: int = 10
    measured: int = 150  # poses: figures 5 to 7, tables 1 and 2
    drawn_from: int = 216  # poses, of which n are drawn: figures 8 and 10
    sizes: tuple[int, ...] = tuple(range(10, 211, 10))
    hidden: int = 16  # units in each of the two hidden layers
    prior: int = 1331  # poses of the source task
    other_hidden: Mapping[int, tuple[int, ...]] = field(  # {hidden: sizes}
        default_factory=lambda: dict.fromkeys((8, 10), (10, 30, 50, 100, 150, 210))
    )
    priors: tuple[int, ...] = (8, 27, 64, 216, 512, 1331, 4913, 9261)  # the outlook: the amount of pre-training data
    few_beyond: int = 1331  # larger source tasks take long:
    few_seeds: int = 2


STUDY = Study()
PREVIEW = Study(  # the same tables and figures from 22 of the 394 jobs
    seeds=2,
    sizes=(10, 50, 100, 210),
    other_hidden=dict.fromkeys((8, 10), (10, 150)),
    priors=(8, 216, 1331),
)


@dataclass(frozen=True)
class Point:
    """One job's place in the study."""

    seed: int
    planned: int
    n: int
    hidden: int
    prior: int

    def overrides(self, study: Study) -> tuple[str, ...]:
        part = (f"split.poses={self.n}",) if self.n < self.planned else ()
        networks = (f"pretrain.hidden={self.hidden}", f"prior.poses={self.prior}")
        open_loop = () if self in tables_points(study) else ("evaluate.closed_loop=false",)
        return (f"seed={self.seed}", f"plan.poses={self.planned}", *part, *networks, *open_loop)

    def __str__(self) -> str:
        return f"n={self.n} of {self.planned} hidden={self.hidden} prior={self.prior} seed={self.seed}"


@dataclass(frozen=True)
class Case(JobPoint):
    """A job, and its place in the study."""

    place: Point


@dataclass(frozen=True)
class Reproduced:
    """What came of it."""

    study: Study
    robot: RobotDescription
    rows: tuple[Row, ...]  # one a job and method: its place, and its errors [deg]
    pose_errors: tuple[PoseErrors, ...]  # one a seed, of the tables' jobs
    made_beyond: tuple[tuple[str, str], ...] = ()  # (stage, key) of their artifacts

    @property
    def table(self) -> pd.DataFrame:
        """The rows, with columns of one type each."""
        import pandas as pd

        table = pd.DataFrame(list(self.rows))
        kinds = {"method": "string"} | dict.fromkeys((n for n in table if str(n).endswith("_deg")), "Float64")
        return table.astype({str(name): kinds.get(str(name), "int64") for name in table})

    @property
    def grids(self) -> tuple[np.ndarray, np.ndarray]:
        """(prior, 3) and (drawn_from, 3): planned angles about x, y, z [deg] of the source task, and of figure 8."""
        from kincal.identification.poses import planned
        from kincal.urdf.description import Plan

        sizes = (self.study.prior, self.study.drawn_from)
        grids = (planned(self.robot.workspace, (3, 4, 5), Plan(poses=n), 0) for n in sizes)
        source, target = (np.rad2deg(u[:, 3:]) for u in grids)
        return source, target


def study_of(seeds: int | None, quick: bool) -> Study:
    """The paper's study, or its preview. Raises InputError."""
    study = PREVIEW if quick else STUDY
    if seeds is None:
        return study
    if not 1 <= seeds <= MOST_SEEDS:
        raise InputError(f"--seeds {seeds}: allowed are 1 to {MOST_SEEDS}")
    return replace(study, seeds=seeds)


def tables_points(study: Study) -> list[Point]:
    """The jobs of tables 1 and 2, one a seed."""
    return [Point(seed, study.measured, study.measured, study.hidden, study.prior) for seed in range(study.seeds)]


def points(study: Study) -> list[Point]:
    """All jobs, those that take long first; neighbours have different seeds, and don't wait for each other."""
    places = []
    for prior in sorted(study.priors, reverse=True):
        few = prior > study.few_beyond
        seeds = range(min(study.seeds, study.few_seeds) if few else study.seeds)
        places += [Point(seed, study.measured, study.measured, study.hidden, prior) for seed in seeds]
    places += tables_points(study)
    for hidden, sizes in {study.hidden: study.sizes, **study.other_hidden}.items():
        for n in sorted(sizes, reverse=True):
            places += [Point(seed, study.drawn_from, n, hidden, study.prior) for seed in range(study.seeds)]
    return list(dict.fromkeys(places))


def plan(
    study: Study, overrides: Sequence[str], store: Path, command: str = ""
) -> tuple[RobotDescription, JobStudy[Case]]:
    """The robot, and its jobs. Raises InputError, also for a setting that is not the user's to choose here."""
    for override in overrides:
        key = ".".join(part.strip() for part in override.partition("=")[0].split("."))
        if any(key == reserved or key.startswith(f"{reserved}.") for reserved in _OWN):
            raise InputError(f"--set {override}: reproduce chooses {key} itself; `kincal sweep` does not")
    loaded = load_robot(ROBOT, overrides)
    robot, file = loaded.description, str(loaded.file)
    if not robot.measure.virtual or not all_turns(robot.measure.channels or ["orientation"]):
        raise InputError(
            "reproduce scores the orientations of a virtual robot: measure.source must be virtual, and "
            'measure.channels must hold "orientation", or "tilt" and "yaw"'
        )
    shared, until = portable(overrides), "evaluate"
    cases = []
    for point in points(study):
        job = Job(file, (*shared, *point.overrides(study)), store.absolute(), until, command)
        cases.append(Case(str(point), job, load_robot(file, job.overrides).description, point))
    return robot, JobStudy(tuple(cases))


def reproduce(
    study: Study,
    robot: RobotDescription,
    jobs: JobStudy[Case],
    on: Place,
    observe: Observe = lambda task, outcome: None,
) -> Reproduced:
    """All jobs, on these workers. Raises CalibrationError where any fails: what the others found stays in the cache."""
    by_place = {case.place: case.job for case in jobs.points}
    with jobs.carried_out(on, observe) as (workers, outcomes):
        jobs.check(outcomes)
        futures = [workers.submit(errors_of, by_place[point]) for point in tables_points(study)]
        errors = tuple(future.result() for future in futures)
    rows = []
    for case, outcome in sorted(zip(jobs.points, outcomes, strict=True), key=lambda pair: _place(pair[0].place)):
        assert isinstance(outcome, Outcome)
        rows += _rows(case.place, outcome)
    return Reproduced(study, robot, tuple(rows), *zip(*errors, strict=True))


def _place(point: Point) -> tuple[int, ...]:
    return (point.planned, point.hidden, point.prior, point.n, point.seed)


def _rows(point: Point, outcome: Outcome) -> list[dict[str, Any]]:
    compared = outcome.comparison
    assert compared is not None
    held_out = {score.name: score for score in compared.held_out}
    closed = {score.name: score for score in compared.closed_loop}
    rows = []
    for score in (compared.raw_nominal, *compared.methods):
        name = score.name
        row = {"seed": point.seed, "planned_poses": point.planned, "n": point.n, "hidden": point.hidden}
        row |= {"prior_poses": point.prior, "method": name}
        for scored_on, part in (("fresh", score), ("held_out", held_out.get(name))):
            row |= {f"{scored_on}_{index}_deg": _number(part, index) for index in _INDICES}
        rows.append(row | {"closed_loop_mean_deg": _number(closed.get(name), "mean")})
    return rows


def _number(score: MethodScore | None, index: str) -> float | None:
    if score is None:
        return None
    return score.axis_mean_deg[index] if index in "xyz" else getattr(score, f"{index}_deg")
