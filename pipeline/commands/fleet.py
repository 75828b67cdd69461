"""`kincal run` and `kincal compare` of several robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from kincal.pipeline.commands.console import out, print_json, say, short, show_comparison, show_table
from kincal.pipeline.commands.options import Common, command_line
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.pipeline.interface.changes import CampaignChanges
    from kincal.pipeline.interface.fleets import FleetResult


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
    result = _carried(robots, everything, source, on, until, output, common)
    _show(result, json)
    result.check()


def compare_fleet(
    robots: Sequence[str], everything: bool, source: Path | None, on: str, json: bool, common: Common
) -> None:
    """Raises as run_fleet does."""
    result = _carried(robots, everything, source, on, "evaluate", None, common)
    changes = _changes(robots, common) if len(robots) == 2 and len(result.comparisons) == 2 else None
    if json and not everything:
        documents = [asdict(comparison) | {"provenance": made_of} for comparison, made_of in result.comparisons]
        if changes is not None:
            documents[-1]["changes"] = changes.to_dict()
        print_json(documents)
    else:
        for comparison, _ in () if everything else result.comparisons:
            show_comparison(comparison)
        _show(result, json)
        if changes is not None:
            for line in changes.lines:
                say(line, "bold")
            if changes.changed:
                show_table(changes.shown())
    result.check()


def _changes(robots: Sequence[str], common: Common) -> CampaignChanges | None:
    """Between two campaigns of one robot; None: they are two designs."""
    from kincal.pipeline.interface.calibration import Calibration
    from kincal.pipeline.interface.changes import changes_between
    from kincal.pipeline.interface.robots import load

    before, after = (Calibration.open(load(robot, common.overrides), store=common.store).fit for robot in robots)
    return changes_between(before, after)


def _carried(
    robots: Sequence[str],
    everything: bool,
    source: Path | None,
    on: str,
    until: str,
    output: Path | None,
    common: Common,
) -> FleetResult:
    from kincal.pipeline.interface.fleets import fleet

    if source is not None and not everything:
        raise InputError(f"--from {source}: goes with --all")
    if everything and robots:
        raise InputError(f"--all and {robots[0]}: allowed is either")
    return fleet(
        source if everything else robots,
        settings=common.overrides,
        until=until,
        workers=on,
        store=common.store,
        output=True if output is None else output,
        progress=True,
        command=command_line(),
    )


def _show(result: FleetResult, json: bool) -> None:
    if json:
        print_json(result.to_dict(), "fleet")
        return
    show_table(result.shown(), align="right" if result.compared else "left")
    for line in result.family_lines():
        out.print(Text(line), soft_wrap=True)
    if result.file is not None:
        out.print(Text(f"table: {short(result.file)}"), soft_wrap=True)
