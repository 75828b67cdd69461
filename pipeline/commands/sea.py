"""The commands of `kincal` at sea."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import out, print_json, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Json, Robot, command_line
from kincal.pipeline.interface.progress import err
from kincal.pipeline.interface.sea import SeaOptions

_DEFAULT = SeaOptions()


def sea_trial(
    robot: Robot,
    *,
    options: Annotated[SeaOptions, Parameter(name="*")] = _DEFAULT,
    output: Path | None = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Simulate the platform on a moving ship: how level each method keeps the deck (the paper's section 4).

    Parameters
    ----------
    output
        The folder of index.html, results.json, series.parquet and the figures (default: NAME_sea_trial).
    json
        The contents of results.json on stdout.
    """
    from kincal.pipeline.interface.robots import load
    from kincal.pipeline.interface.sea import sea_trial as sailed

    loaded = load(robot, common.overrides)
    result = sailed(loaded, options, store=common.store, progress=True, command=command_line())
    page = result.save(output or Path(f"{loaded.description.name}_sea_trial"))
    document = result.to_dict()
    for innovation in document["filter"]["innovations"]:
        if innovation["warning"]:
            err.print(Text(f"warning: {innovation['warning']}", style="yellow"), soft_wrap=True)
    if json:
        print_json(document)
        return
    out.print(Text(document["motion"]["said"]), soft_wrap=True)
    for title, table in result.shown():
        out.print(Text(title, style="bold"))
        show_table(table)
    out.print(Text(f"page: {short(page)}"), soft_wrap=True)
