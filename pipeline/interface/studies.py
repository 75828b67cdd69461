"""Many calibrations at once: sweeps over settings and seeds, fleets of robots, and the paper's simulation."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from kincal.pipeline.interface.arguments import path, whole_number
from kincal.pipeline.interface.job_progress import JobObserver, job_observer
from kincal.pipeline.interface.robots import RobotLike, Settings, overrides_of, robot_of
from kincal.pipeline.interface.sessions import opened, temporary_folder
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.reproduce.page import Findings
    from kincal.pipeline.results import Comparison
    from kincal.pipeline.studies.fleet import Fleet
    from kincal.pipeline.studies.grid import Over as SweptKey
    from kincal.pipeline.studies.sweep import Sweep

Over: TypeAlias = "Mapping[str, Sequence[Any]] | Sequence[str]"
_COMMAND = "kincal in Python"


@contextmanager
def _folder(store: str | PathLike[str] | None) -> Generator[Path]:
    """The store of a study; None: a temporary one, removed at the end."""
    folder = temporary_folder() if store is None else path("store", store)
    try:
        yield folder
    finally:
        if store is None:
            shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True, repr=False)
class SweepResult:
    """What came of a sweep.

    Attributes
    ----------
    swept
        The full result.
    files
        The table and the figure that were written, if any.
    provenance
        Versions and digests of what the results were made of.

    Examples
    --------
    >>> import kincal
    >>> quick = {"prior.poses": 64, "siblings.count": 2, "siblings.iterations": 20, "evaluate.closed_loop": False}
    >>> result = kincal.sweep(kincal.load("ups3_s", quick), over={"plan.poses": [12, 16]})
    >>> result.medians[["plan.poses", "method"]].shape
    (12, 2)
    """

    swept: Sweep
    files: tuple[Path, Path | None] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def table(self) -> pd.DataFrame:
        """One row a job and method, one row a job that failed: the swept values, the errors [deg, mm], `error`."""
        return self.swept.table

    @property
    def medians(self) -> pd.DataFrame:
        """One row a combination of swept values and method: jobs, median and quartiles of mean errors over seeds."""
        from kincal.pipeline.studies.medians import medians

        return medians(self.swept)

    def check(self) -> None:
        """Raise an InputError where all jobs were bad input, a CalibrationError where any failed otherwise."""
        self.swept.check()

    def shown(self) -> list[tuple[str, Table]]:
        """Medians for people: a title and a table for each unit."""
        from kincal.pipeline.studies.medians import median_tables

        return median_tables(self.swept)

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal sweep --json`."""
        from kincal.pipeline.studies.sweep_files import sweep_json

        table, figure = self.files or (None, None)
        return sweep_json(self.swept, table, figure) | {"provenance": dict(self.provenance)}

    def __repr__(self) -> str:
        return f"SweepResult({self.swept.robot!r}, {len(self.swept.outcomes)} jobs, {self.swept.n_failed} failed)"


def sweep(
    robot: RobotLike,
    over: Over = (),
    *,
    seeds: int = 1,
    workers: int | str = 1,
    store: str | PathLike[str] | None = None,
    output: str | PathLike[str] | bool = False,
    progress: JobObserver = False,
    command: str = _COMMAND,
) -> SweepResult:
    """Calibrate a robot over a grid of settings and seeds.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes.
    over
        The swept settings and their values: `{"plan.poses": [20, 50]}`, or texts as after `--over` of the command
        line. Several settings: every combination.
    seeds
        How many seeds, from 0. 1: the robot's own.
    workers
        How many worker processes (1: this process), or `dask://host:port`.
    store
        The folder of cached results. Default: a temporary folder, removed at the end.
    output
        A folder for sweep.parquet and sweep.svg. True: the robot's folder in the store. Default: nothing is written.
    progress
        True: a bar on stderr. A function: called with a `JobEvent` at the end of each job.
    command
        What the provenance says about where the results came from.

    Returns
    -------
    SweepResult
        A job that failed is a row with its error; `check()` raises it.

    Raises
    ------
    InputError
        The robot or the grid is not usable, no job is valid, or the output can't be written.

    Examples
    --------
    >>> import kincal
    >>> quick = {"prior.poses": 64, "siblings.count": 2, "siblings.iterations": 20, "evaluate.closed_loop": False}
    >>> result = kincal.sweep(kincal.load("ups3_s", quick), over={"plan.poses": [12, 16]})
    >>> result.table["method"].nunique()
    6
    """
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.studies.sweep import plan_sweep
    from kincal.pipeline.studies.sweep import sweep as swept_on
    from kincal.pipeline.studies.sweep_files import write
    from kincal.pipeline.studies.used import Used

    where, loaded, seeds = place(str(workers)), robot_of(robot), whole_number("seeds", seeds)
    overs = _overs(over)
    with _folder(store) as root:
        grid, study = plan_sweep(loaded, overs, seeds, root, command)
        session = opened(loaded, root, command=command)
        folder = _output(output, root / "robots" / session.robot_id)
        name = loaded.description.name
        with job_observer(progress, name, study.labels) as observe:
            used = Used(observe)
            swept = swept_on(name, grid, study, where, used)
        swept.table.attrs["provenance"] = used.provenance()
        result = SweepResult(swept, None, {"command": command} | used.provenance())
        if folder is None:
            return result
        files = write(swept, folder)
        used.finish(session, "sweep", files[0])
        return SweepResult(swept, files, result.provenance)


@dataclass(frozen=True, repr=False)
class FleetResult:
    """What came of a fleet.

    Attributes
    ----------
    carried
        The full result, robot by robot.
    until
        The last stage that ran.
    file
        The table that was written.

    Examples
    --------
    >>> import kincal
    >>> result = kincal.fleet(["ups3_s", "rps3"], until="model")
    >>> result.table["robot"].tolist()
    ['ups3_s', 'rps3']
    """

    carried: Fleet
    until: str
    table: pd.DataFrame
    file: Path | None = None

    @property
    def compared(self) -> bool:
        """Whether the methods were compared: the last stage was `evaluate` or `report`."""
        return _compared(self.until)

    @property
    def comparisons(self) -> list[tuple[Comparison, Mapping[str, Any]]]:
        """The comparison and its provenance of each robot that did not fail."""
        from kincal.pipeline.run.fan_out import Outcome

        outcomes = (outcome for outcome in self.carried.outcomes if isinstance(outcome, Outcome))
        return [(outcome.comparison, outcome.provenance) for outcome in outcomes if outcome.comparison is not None]

    def check(self) -> None:
        """Raise an InputError where all robots were bad input, a CalibrationError where any failed otherwise."""
        self.carried.check()

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal run --all --json`."""
        from kincal.pipeline.studies.fleet_table import fleet_json, stage_json

        if not self.compared:
            return stage_json(self.carried, self.until)
        return fleet_json(self.carried, self.table, self.file)

    def shown(self) -> Table:
        """One row a robot, for people."""
        from kincal.pipeline.studies.fleet_table import shown_table, stage_table

        return shown_table(self.table) if self.compared else stage_table(self.carried, self.until)

    def family_lines(self) -> list[str]:
        """What the columns mean, where a family was judged."""
        from kincal.pipeline.studies.fleet_table import family_lines

        return family_lines(self.table) if self.compared else []

    def __repr__(self) -> str:
        return f"FleetResult({self.carried.name!r}, {len(self.carried.members)} robots)"


def fleet(
    robots: Sequence[str] | str | PathLike[str] | None,
    *,
    settings: Settings = (),
    until: str = "evaluate",
    workers: int | str = 1,
    store: str | PathLike[str] | None = None,
    output: str | PathLike[str] | bool = False,
    progress: JobObserver = False,
    command: str = _COMMAND,
) -> FleetResult:
    """Calibrate many robots, and find the unit that is out of family.

    Parameters
    ----------
    robots
        A list of what `load` takes; the path of a fleet file, or of a folder of robots' folders; None: all shipped
        robots.
    settings
        Values that replace those of each robot.toml, as in `load`.
    until
        The last stage to run.
    workers
        How many worker processes (1: this process), or `dask://host:port`.
    store
        The folder of cached results. Default: a temporary folder, removed at the end.
    output
        A folder for fleet.parquet. True: one in the store. Default: nothing is written.
    progress
        True: a bar on stderr. A function: called with a `JobEvent` at the end of each job.
    command
        What the provenance says about where the results came from.

    Returns
    -------
    FleetResult
        A robot that failed is a row with its error; `check()` raises it.

    Raises
    ------
    InputError
        There is no such file, stage or robot, or no robot is valid.

    Examples
    --------
    >>> import kincal
    >>> kincal.fleet(["ups3_s"], until="model").table["state"].tolist()
    ['ran']
    """
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.run.stage import needed
    from kincal.pipeline.studies.fleet import Fleet, plan_fleet, select
    from kincal.pipeline.studies.fleet_table import fleet_table, stage_frame, write_table

    where, chosen = place(str(workers)), select(robots)
    needed(until)  # refuses a stage that does not exist
    with _folder(store) as root:
        study = plan_fleet(chosen, overrides_of(settings), root, until, command)
        folder = _output(output, root.absolute() / "fleets" / chosen.folder)
        with job_observer(progress, chosen.name, study.labels, named=True) as observe:
            carried = Fleet(chosen.name, study, tuple(study.run(where, observe)))
        if not _compared(until):
            return FleetResult(carried, until, stage_frame(carried))
        table = fleet_table(carried)
        return FleetResult(carried, until, table, None if folder is None else write_table(carried, table, folder))


def _overs(over: Any) -> list[SweptKey]:
    """Raises InputError."""
    from kincal.pipeline.studies.grid import over_of, parse_over

    if isinstance(over, Mapping):
        return [over_of(key, values) for key, values in cast("Mapping[str, Any]", over).items()]
    if isinstance(over, Sequence) and not isinstance(over, str):
        return [parse_over(text) for text in cast("Sequence[str]", over)]
    raise InputError(f'over: found {over!r}; allowed are {{"plan.poses": [20, 50]}} and texts, ["plan.poses=20,50"]')


def _output(output: str | PathLike[str] | bool, in_store: Path) -> Path | None:
    """The folder of a study's files, tried before hours of work; None: none are wanted. Raises InputError."""
    from kincal.pipeline.store.files import output_folder

    if output is False:
        return None
    return output_folder(None if output is True else path("output", output), in_store)


def _compared(until: str) -> bool:
    return until in ("evaluate", "report")


@dataclass(frozen=True, repr=False)
class Reproduction:
    """The paper's simulation, as it came out here.

    Attributes
    ----------
    findings
        Tables, figures and the document.
    page
        The page that was written.

    Examples
    --------
    >>> import kincal
    >>> kincal.Reproduction.__name__
    'Reproduction'
    """

    findings: Findings
    page: Path

    def shown(self) -> list[tuple[str, Table]]:
        """The main tables for people, each with its title."""
        from kincal.pipeline.reproduce.page import summary

        return summary(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The contents of results.json."""
        return self.findings.document

    def __repr__(self) -> str:
        return f"Reproduction({self.page})"


def reproduce(
    *,
    seeds: int = 10,
    workers: int | str = 2,
    settings: Settings = (),
    store: str | PathLike[str] = ".kincal",
    output: str | PathLike[str] = "reproduced",
    progress: JobObserver = False,
    command: str = _COMMAND,
) -> Reproduction:
    """Reproduce the simulation of Xu, Tian and Zhang on `ups3_s`: every table and figure, all methods.

    Parameters
    ----------
    seeds
        How many seeds, from 0: each draws robot, noise, split and networks. Ten take a quarter of an hour.
    workers
        How many worker processes (1: this process), or `dask://host:port`.
    settings
        Values that replace those of robot.toml, as in `load`.
    store
        The folder of cached results.
    output
        The folder of index.html, the figures, the tables and results.json.
    progress
        True: a bar on stderr. A function: called with a `JobEvent` at the end of each job.
    command
        What the provenance says about where the results came from.

    Returns
    -------
    Reproduction

    Raises
    ------
    InputError
        A setting that the study chooses itself, or an output that can't be written.
    CalibrationError
        A job failed.

    Notes
    -----
    J. Mar. Sci. Eng. 2024, 12, 275, section 3.

    Examples
    --------
    >>> import kincal
    >>> kincal.reproduce(seeds=0)
    Traceback (most recent call last):
    kincal.urdf.errors.InputError: --seeds 0: allowed are 1 to 200
    """
    from kincal.pipeline.reproduce.page import findings, write
    from kincal.pipeline.reproduce.study import ROBOT, plan, study_of
    from kincal.pipeline.reproduce.study import reproduce as reproduced
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.studies.used import Used

    where, study = place(str(workers)), study_of(whole_number("seeds", seeds))
    overrides, root = overrides_of(settings), path("store", store)
    robot, jobs = plan(study, overrides, root, command)
    folder = _output(output, root)
    assert folder is not None
    with job_observer(progress, robot.name, jobs.labels) as observe:
        used = Used(observe)
        results = reproduced(study, robot, jobs, where, used)
    made = findings(results)
    made.document["provenance"] = used.provenance()
    page = write(results, made, folder)
    used.finish(opened(robot_of(ROBOT, overrides), root, command=command), "reproduce", page, results.made_beyond)
    return Reproduction(made, page)
