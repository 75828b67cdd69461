"""Many robots at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.job_progress import JobObserver, job_observer
from kincal.pipeline.interface.robots import Settings, overrides_of
from kincal.pipeline.interface.sessions import COMMAND
from kincal.pipeline.interface.study_folders import output_of, store_of

if TYPE_CHECKING:
    import pandas as pd

    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.results import Comparison
    from kincal.pipeline.studies.fleet import Fleet


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
    command: str = COMMAND,
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
        How many worker processes (1: this process), `dask://host:port`, or `tls://host:port`.
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
    with store_of(store) as root:
        study = plan_fleet(chosen, overrides_of(settings), root, until, command)
        folder = output_of(output, root.absolute() / "fleets" / chosen.folder)
        with job_observer(progress, chosen.name, study.labels, named=True) as observe:
            carried = Fleet(chosen.name, study, tuple(study.run(where, observe)))
        if not _compared(until):
            return FleetResult(carried, until, stage_frame(carried))
        table = fleet_table(carried)
        return FleetResult(carried, until, table, None if folder is None else write_table(carried, table, folder))


def _compared(until: str) -> bool:
    return until in ("evaluate", "report")
