"""The commands of many runs at once: `kincal sweep` and `kincal reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import note_virtual, out, print_json, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, Json, Robot, command_line


def sweep(
    robot: Robot,
    *,
    over: Annotated[list[str] | None, Parameter(name="--over", negative=())] = None,
    seeds: int = 1,
    on: str = "1",
    output: Path | None = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Calibrate over a grid of settings and seeds: one table of all runs, and the medians over the seeds.

    Parameters
    ----------
    over
        A setting and its values: table.key=10,20,...,210, in TOML syntax; repeated, every combination.
    seeds
        How many seeds, from 0; 1: the robot's own.
    on
        How many worker processes (1: this process), dask://host:port, or tls://host:port.
    output
        The folder of sweep.parquet and sweep.svg (default: the robot's folder in the store).
    """
    from kincal.pipeline.interface.robots import load
    from kincal.pipeline.interface.sweeps import sweep as swept

    loaded = load(robot, common.overrides)
    result = swept(
        loaded,
        over or (),
        seeds=seeds,
        workers=on,
        store=common.store,
        output=True if output is None else output,
        progress=True,
        command=command_line(),
    )
    if json:
        print_json(result.to_dict(), "sweep")
    else:
        for title, medians in result.shown():
            out.print(Text(f"{loaded.description.name}: {title}", style="bold"))
            show_table(medians)
        for kind, file in zip(("table", "figure"), result.files or (), strict=False):
            if file is not None:
                out.print(Text(f"{kind}: {short(file)}"), soft_wrap=True)
    note_virtual(loaded.description)
    result.check()


def reproduce(
    *,
    seeds: int | None = None,
    quick: Flag = False,
    on: str = "2",
    output: Path = Path("reproduced"),
    json: Annotated[Json, Parameter(help="The contents of results.json on stdout.")] = False,
    common: Common = COMMON,
) -> None:
    """Reproduce the simulation of Xu, Tian and Zhang (2024): every table and figure beside the paper's numbers.

    Parameters
    ----------
    seeds
        How many seeds, from 0: each draws robot, noise, split and networks (default: 10; with --quick: 2).
    quick
        A preview in about half a minute: fewer sizes and seeds, wider intervals.
    on
        How many worker processes (1: this process), dask://host:port, or tls://host:port.
    output
        The folder of index.html, the figures, the tables and results.json.
    """
    from kincal.pipeline.interface.reproduction import reproduce as reproduced

    result = reproduced(
        seeds=seeds,
        quick=quick,
        workers=on,
        settings=common.overrides,
        store=common.store,
        output=output,
        progress=True,
        command=command_line(),
    )
    document = result.to_dict()
    if json:
        print_json(document)
        return
    for title, table in result.shown():
        out.print(Text(title, style="bold"))
        show_table(table)
    for verdict in document["verdicts"]:
        out.print(Text(verdict), soft_wrap=True)
    out.print(Text(f"page: {short(result.page)}"), soft_wrap=True)
