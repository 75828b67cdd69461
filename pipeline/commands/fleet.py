"""`kincal run` and `kincal compare` of several robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from kincal.pipeline.commands.console import out, print_json, short, show_comparison, show_table
from kincal.pipeline.commands.options import Common, command_line

if TYPE_CHECKING:
    from kincal.pipeline.studies.fleet import Carried


def run_fleet(
    robots: Sequence[str],
    everything: bool,
    source: Path | None,
    on: str,
    until: str,
    output: Path | None,
    json: bool,
    common: Common,
) -> None:
    """Raises InputError, also where all robots were bad input; CalibrationError where any failed otherwise."""
    folder, came = _carried(robots, everything, source, on, until, output, common)
    if until not in ("evaluate", "report"):
        from kincal.pipeline.studies.fleet_table import stage_json, stage_table

        if json:
            print_json(stage_json(came, until))
        else:
            show_table(stage_table(came, until), align="left")
    else:
        _show(came, folder, json)
    came.check()


def compare_fleet(
    robots: Sequence[str], everything: bool, source: Path | None, on: str, json: bool, common: Common
) -> None:
    """Raises as run_fleet does."""
    folder, came = _carried(robots, everything, source, on, "evaluate", None, common)
    if everything:
        _show(came, folder, json)
    else:
        from kincal.pipeline.run.fan_out import Outcome

        compared = [(c.comparison, c.provenance) for c in came.outcomes if isinstance(c, Outcome) and c.comparison]
        if json:
            print_json([asdict(comparison) | {"provenance": found} for comparison, found in compared])
        else:
            for comparison, _ in compared:
                show_comparison(comparison)
            _show(came, folder, json)
    came.check()


def _carried(
    robots: Sequence[str],
    everything: bool,
    source: Path | None,
    on: str,
    until: str,
    output: Path | None,
    common: Common,
) -> tuple[Path, Carried]:
    from kincal.pipeline.commands.job_progress import JobProgress
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.run.stage import needed
    from kincal.pipeline.store.files import output_folder
    from kincal.pipeline.studies.fleet import carry_all, plan_fleet, select

    where, chosen = place(on), select(robots, everything, source)
    needed(until)  # refuses a stage that does not exist
    members = plan_fleet(chosen, common.overrides, common.store, until, command_line())
    folder = output_folder(output, common.store.absolute() / "fleets" / chosen.folder)
    with JobProgress(chosen.name, {m.job: m.name for m in members}, named=True) as progress:
        return folder, carry_all(chosen.name, members, where, progress)


def _show(came: Carried, folder: Path, json: bool) -> None:
    from kincal.pipeline.studies.fleet_table import family_lines, fleet_json, fleet_table, shown_table, write_table

    table = fleet_table(came)
    file = write_table(came, table, folder)
    if json:
        print_json(fleet_json(came, table, file))
        return
    show_table(shown_table(table))
    for line in family_lines(table):
        out.print(Text(line), soft_wrap=True)
    out.print(Text(f"table: {short(file)}"), soft_wrap=True)
