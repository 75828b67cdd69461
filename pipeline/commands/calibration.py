"""The commands around one robot's calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import (
    check_verdict,
    note_virtual,
    print_json,
    print_table,
    say,
    short,
    show_comparison,
    show_findings,
    show_verdict,
)
from kincal.pipeline.commands.fleet import compare_fleet, run_fleet
from kincal.pipeline.commands.options import (
    COMMON,
    All,
    Common,
    Flag,
    From,
    Json,
    JsonInstead,
    On,
    Robot,
    opened,
)
from kincal.pipeline.interface.progress import err
from kincal.urdf.errors import InputError


def run(
    *robots: str,
    all: All = False,
    source: From = None,
    on: On = "1",
    until: str = "report",
    force_from: str | None = None,
    output: Path | None = None,
    json: Annotated[
        Json, Parameter(help="One JSON document on stdout: the comparison; of several, the table.")
    ] = False,
    common: Common = COMMON,
) -> None:
    """Calibrate a robot: run all stages, compare the methods, write the report. Several robots: a table of the fleet.

    Parameters
    ----------
    robots
        Shipped robots' names, paths to robot.toml, or FLEET.toml:UNIT.
    until
        The last stage to run.
    force_from
        Run this stage and all after it, cached or not.
    output
        The folder of fleet.parquet (default: in the store).
    """
    if len(robots) != 1 or all or source is not None or on != "1" or output is not None:
        if force_from is not None:
            raise InputError("--force-from: allowed with one robot, in this process")
        run_fleet(robots, all, source, on, until, output, json, common)
        return
    calibration = opened(robots[0], common, force_from)
    last = "evaluate" if until == "report" else until
    if until == "report":
        calibration.until("evaluate", "report")
        page = calibration.report()
    if json:
        print_json(calibration.document(last), "comparison" if last == "evaluate" else "stage")
        check_verdict(calibration.verdict if until == "report" else None)
        return
    if until != "report":
        calibration.until(until)
        return
    show_comparison(calibration.comparison)
    show_findings(calibration.fit)
    if page.is_file():
        say(f"Report: {short(page)}")
    else:
        err.print(Text(f"warning: {page}: can't be written", style="yellow"), soft_wrap=True)
    show_verdict(calibration.verdict)


def compare(
    *robots: str,
    all: All = False,
    source: From = None,
    on: On = "1",
    json: Annotated[
        Json, Parameter(help="One JSON document on stdout; a list where there are several robots.")
    ] = False,
    common: Common = COMMON,
) -> None:
    """Compare the six methods at poses that they were not trained on. Two campaigns of one robot: also what changed.

    Parameters
    ----------
    robots
        Shipped robots' names, paths to robot.toml, or FLEET.toml:UNIT.
    """
    if len(robots) != 1 or all or source is not None or on != "1":
        compare_fleet(robots, all, source, on, json, common)
        return
    calibration = opened(robots[0], common)
    if json:
        print_json(calibration.document(), "comparison")
        check_verdict(calibration.verdict)
    else:
        show_comparison(calibration.comparison)
        show_verdict(calibration.verdict)


def inspect(
    robot: Robot,
    *,
    before: Flag = False,
    all: Annotated[bool, Parameter(name="--all", negative=())] = False,
    plot: Path | None = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Show the identified geometry: verdict, findings, and the parameters that moved.

    Parameters
    ----------
    before
        Predict what the planned poses will determine, before anybody measures.
    all
        Also list every parameter, and the directions that the measurements do not determine.
    plot
        Draw singular values, shares and changes into this .svg, .png or .pdf file.
    """
    from kincal.pipeline.commands.inspection import show_foresight, show_inspection, show_whole_inspection

    calibration = opened(robot, common)
    if before:
        foresight = calibration.foresight
        if plot is not None:
            foresight.plot(plot)
    else:
        fit = calibration.fit
        if plot is not None:
            fit.plot(plot)
    if json:
        document = foresight.to_dict() if before else fit.to_dict()
        made = {"virtual": calibration.virtual, "provenance": calibration.provenance("plan" if before else "identify")}
        print_json(document | made, "foresight" if before else "identification")
        return
    if before:
        show_foresight(foresight)
    elif all:
        show_whole_inspection(fit)
    else:
        show_inspection(fit)
    if plot is not None:
        say(f"Plot: {short(plot.absolute())}")


def status(robot: Robot, *, json: Json = False, common: Common = COMMON) -> None:
    """List the stages: fresh or stale, and why."""
    from kincal.pipeline.commands.console import show_table
    from kincal.pipeline.report.tables import Table

    columns = ("stage", "state", "why")
    rows = opened(robot, common).stages()
    if json:
        print_json([dict(zip(columns, row, strict=True)) for row in rows])
        return
    show_table(Table(columns, tuple(rows)), align="left")


def predict(
    robot: Robot, *, joints: Path, method: str = "hybrid", json: JsonInstead = False, common: Common = COMMON
) -> None:
    """Predict poses and their standard deviations at given joint readings, as CSV on stdout.

    Parameters
    ----------
    joints
        A CSV or Parquet table with one column a joint, as in the measurement table.
    method
        One of the methods that `compare` lists.
    """
    calibration = opened(robot, common)
    print_table(calibration.predict(joints, method=method), json)
    note_virtual(calibration.robot.description)


def compensate(
    robot: Robot, *, poses: Path, method: str = "hybrid", json: JsonInstead = False, common: Common = COMMON
) -> None:
    """Compute the joint commands for desired poses, as CSV on stdout.

    Parameters
    ----------
    poses
        A CSV or Parquet table of desired poses in the measurement frame: the columns of a measurement table.
    method
        One of the methods that `compare` lists.
    """
    calibration = opened(robot, common)
    commands = calibration.compensate(poses, method=method, strict=True)
    print_table(commands.drop(columns=["reached", "obstacle"]), json)
    note_virtual(calibration.robot.description)


def evaluate(
    robot: Robot,
    *,
    data: Path,
    columns: Path | None = None,
    register: Flag = False,
    rehome: Flag = False,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Measure the errors of the methods on a table that was not used for the calibration.

    Parameters
    ----------
    data
        The measurement table, CSV or Parquet.
    columns
        A TOML file with the column map of this table, as in [measure.columns].
    register
        First fit W again: the instrument was set up anew.
    rehome
        First fit the actuators' zeros again: the robot was homed anew.
    """
    calibration = opened(robot, common)
    comparison = calibration.evaluation(data, register=register, rehome=rehome, columns=columns)
    if not json:
        show_comparison(comparison)
        show_verdict(calibration.verdict_of(comparison))
        return
    files = {"data": data} | ({"columns": columns} if columns else {})
    provenance = calibration.provenance("identify", "transfer", "correct", files=files)
    print_json(calibration.comparison_document(comparison) | {"provenance": provenance}, "comparison")
    check_verdict(calibration.verdict_of(comparison))
