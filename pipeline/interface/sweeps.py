"""One robot over a grid of settings and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from kincal.pipeline.interface.arguments import whole_number
from kincal.pipeline.interface.job_progress import JobObserver, job_observer
from kincal.pipeline.interface.robots import RobotLike, robot_of
from kincal.pipeline.interface.sessions import COMMAND, opened
from kincal.pipeline.interface.study_folders import output_of, store_of
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.studies.grid import Over as SweptKey
    from kincal.pipeline.studies.sweep import Sweep

Over: TypeAlias = "Mapping[str, Sequence[Any]] | Sequence[str]"


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
    command: str = COMMAND,
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
        How many worker processes (1: this process), `dask://host:port`, or `tls://host:port`.
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
    with store_of(store) as root:
        grid, study = plan_sweep(loaded, overs, seeds, root, command)
        session = opened(loaded, root, command=command)
        folder = output_of(output, root / "robots" / session.robot_id)
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


def _overs(over: Any) -> list[SweptKey]:
    """Raises InputError."""
    from kincal.pipeline.studies.grid import over_of, parse_over

    if isinstance(over, Mapping):
        return [over_of(key, values) for key, values in cast("Mapping[str, Any]", over).items()]
    if isinstance(over, Sequence) and not isinstance(over, str):
        return [parse_over(text) for text in cast("Sequence[str]", over)]
    raise InputError(f'over: found {over!r}; allowed are {{"plan.poses": [20, 50]}} and texts, ["plan.poses=20,50"]')
