"""The commands before anybody measures: `kincal init` and `kincal plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rich.text import Text

from kincal.pipeline.commands.console import aside, out, print_json, print_table, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, JsonInstead, Robot
from kincal.pipeline.interface.progress import err


def init(drawing: Path, *, output: Path | None = None) -> None:
    """Propose a robot.toml for a URDF or an MJCF: loops, actuators and workspace, with reasons in comments.

    Parameters
    ----------
    drawing
        The URDF or MJCF file.
    output
        The file to write, which must not exist (default: robot.toml beside the drawing).
    """
    from kincal.pipeline.interface.robots import propose

    proposal = propose(drawing, output)
    for remark in proposal.remarks:
        err.print(Text(f"note: {remark}", style="yellow"), soft_wrap=True)
    out.print(Text(f"{short(proposal.file)}: {proposal.summary}"), soft_wrap=True)


def schema(*, output: Path | None = None) -> None:
    """Print the JSON Schema of robot.toml, by which editors check and complete it.

    Parameters
    ----------
    output
        The file to write instead, for example robot.schema.json beside robot.toml.
    """
    from kincal.pipeline.interface.robots import robot_schema, write_schema

    if output is None:
        print_json(robot_schema())
    else:
        out.print(Text(f"{short(write_schema(output))}: the JSON Schema of robot.toml"), soft_wrap=True)


def plan(
    robot: Robot,
    *,
    poses: int | None = None,
    layout: Literal["d_optimal", "grid", "random"] | None = None,
    accuracy: float | None = None,
    accuracy_mm: float | None = None,
    output: Path | None = None,
    force: Flag = False,
    json: JsonInstead = False,
    common: Common = COMMON,
) -> None:
    """Plan the poses to measure: the table as CSV on stdout, the predicted accuracy on stderr.

    Parameters
    ----------
    poses
        How many; default: as many as --accuracy needs, else plan.poses of robot.toml.
    layout
        Default: plan.layout of robot.toml, else d_optimal.
    accuracy
        Print how many poses each layout needs for this mean error [deg] of the identified model.
    accuracy_mm
        The same for the position [mm].
    output
        Write the table to this .csv or .parquet file instead.
    force
        Replace the output file if it exists.
    """
    from kincal.pipeline.interface.campaign import plan as planned
    from kincal.pipeline.interface.robots import load

    result = planned(
        load(robot, common.overrides),
        poses=poses,
        layout=layout,
        accuracy_deg=accuracy,
        accuracy_mm=accuracy_mm,
        output=output,
        force=force,
        store=common.store,
        progress=True,
    )
    report = result.report
    for warning in report.warnings:
        err.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)
    if json:
        print_json(result.to_dict(), "plan")
        return
    channels = ", ".join(report.channels)
    err.print(f"{report.robot}: {len(result)} poses, measured {channels}; as predicted:", style="bold")
    layouts, needed = result.shown()
    show_table(layouts, console=aside)
    if needed is not None:
        err.print(f"poses for a predicted mean error of {report.wanted}:", style="bold")
        show_table(needed, console=aside)
    if output is None:
        print_table(result.poses, False)
