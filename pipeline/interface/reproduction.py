"""The paper's simulation."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.arguments import path, whole_number
from kincal.pipeline.interface.job_progress import JobObserver, job_observer
from kincal.pipeline.interface.robots import Settings, overrides_of, robot_of
from kincal.pipeline.interface.sessions import COMMAND, opened
from kincal.pipeline.interface.study_folders import output_of

if TYPE_CHECKING:
    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.reproduce.page import Findings


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
    seeds: int | None = None,
    quick: bool = False,
    workers: int | str = 2,
    settings: Settings = (),
    store: str | PathLike[str] = ".kincal",
    output: str | PathLike[str] = "reproduced",
    progress: JobObserver = False,
    command: str = COMMAND,
) -> Reproduction:
    """Reproduce the simulation of Xu, Tian and Zhang on `ups3_s`: every table and figure, all methods.

    Parameters
    ----------
    seeds
        How many seeds, from 0: each draws robot, noise, split and networks. Default: 10, which take a quarter of an
        hour; of the preview 2.
    quick
        A preview with fewer sizes and seeds: the same tables and figures, wider intervals.
    workers
        How many worker processes (1: this process), `dask://host:port`, or `tls://host:port`.
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

    where, study = place(str(workers)), study_of(None if seeds is None else whole_number("seeds", seeds), quick)
    overrides, root = overrides_of(settings), path("store", store)
    robot, jobs = plan(study, overrides, root, command)
    folder = output_of(output, root)
    assert folder is not None
    with job_observer(progress, robot.name, jobs.labels) as observe:
        used = Used(observe)
        results = reproduced(study, robot, jobs, where, used)
    made = findings(results)
    made.document["provenance"] = used.provenance()
    page = write(results, made, folder)
    used.finish(opened(robot_of(ROBOT, overrides), root, command=command), "reproduce", page, results.made_beyond)
    return Reproduction(made, page)
