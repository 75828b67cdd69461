"""The command `kincal`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter
from rich.text import Text

from kincal.pipeline.commands import cache as store_commands
from kincal.pipeline.commands import sea as sea_commands
from kincal.pipeline.commands import studies as study_commands
from kincal.pipeline.commands.console import (
    err,
    out,
    print_json,
    print_table,
    short,
    show_comparison,
    show_inspection,
    show_table,
)
from kincal.pipeline.commands.fleet import compare_fleet, run_fleet
from kincal.pipeline.commands.options import COMMON, All, Common, Flag, From, Json, JsonInstead, On, Robot, opened
from kincal.urdf.errors import CalibrationError, InputError, of_system, one_line

if TYPE_CHECKING:
    from kincal.pipeline.run.runner import Run

app = App(
    name="kincal",
    help="Calibrates closed-chain (parallel) robots from a handful of measured poses.",
    help_format="plaintext",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # main says so
)
for _command in (study_commands.export, study_commands.plan, study_commands.sweep, study_commands.reproduce):
    app.command(_command)
for _command in (store_commands.gc, store_commands.accept, store_commands.verify):
    app.command(_command)
app.command(sea_commands.sea_trial)


@app.command
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
    """Run the staged pipeline, and end with the comparison; of several robots, with the fleet's table.

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
    from kincal.pipeline.run.stage import needed

    session = opened(robots[0], common, force_from)
    if force_from is not None and force_from not in (stage.name for stage in needed(until)):
        raise InputError(f"--force-from {force_from}: --until {until} does not need that stage")
    if until != "report":
        (value,) = session.until(until)
        if json:
            name = session.robot.description.name
            said = asdict(value) if until == "evaluate" else {"robot": name, "stage": until}
            print_json(_document(session, said, until))
        return
    compared, report = session.until("evaluate", "report")
    page = session.publish(report)
    if json:
        print_json(_document(session, asdict(compared)))
        return
    show_comparison(compared)
    if page.is_file():
        out.print(Text(f"report: {short(page)}"))
    else:
        err.print(Text(f"warning: {page}: can't be written", style="yellow"), soft_wrap=True)


@app.command
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
    """The methods side by side on the same held-out poses; of several robots, the fleet's table too.

    Parameters
    ----------
    robots
        Shipped robots' names, paths to robot.toml, or FLEET.toml:UNIT.
    """
    if len(robots) != 1 or all or source is not None or on != "1":
        compare_fleet(robots, all, source, on, json, common)
        return
    session = opened(robots[0], common)
    (compared,) = session.until("evaluate")
    if json:
        print_json(_document(session, asdict(compared)))
    else:
        show_comparison(compared)


def _document(session: Run, said: dict[str, Any], until: str = "evaluate") -> dict[str, Any]:
    from kincal.pipeline.run.provenance import provenance

    return said | {"provenance": provenance(session.entries, [until], session.command)}


@app.command
def inspect(
    robot: Robot,
    *,
    before: Flag = False,
    plot: Path | None = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Every parameter: nominal, identified, change, sigma; what could not be seen, and how sure the rest is.

    Parameters
    ----------
    before
        From the planned poses and the sensors alone, before anybody measures.
    plot
        Draw singular values, shares and changes into this .svg, .png or .pdf file.
    """
    from kincal.pipeline.report.tables import foreseen_json, parameters_json

    session = opened(robot, common)
    name, more, foresight = session.robot.description.name, {}, None
    if before:
        from kincal.pipeline.planning.foresight import foresee

        foresight = foresee(session)
        found, more = foresight.identification, foresight.json()
    else:
        found = session.until("identify")[0].shipped
    if plot is not None:
        from kincal.pipeline.report.identification_figures import draw

        draw(found, plot, before)
    if json:
        from kincal.pipeline.run.provenance import provenance

        document = foreseen_json(name, found, more) if before else parameters_json(name, found)
        stages = ["plan" if before else "identify"]
        print_json(document | {"provenance": provenance(session.entries, stages, session.command)})
        return
    show_inspection(name, found, foresight)
    if plot is not None:
        out.print(Text(f"plot: {short(plot.absolute())}"))


@app.command
def status(robot: Robot, *, json: Json = False, common: Common = COMMON) -> None:
    """Which stages are fresh, which are stale, and what made them so."""
    rows = list(opened(robot, common).status())
    if json:
        print_json([dict(zip(("stage", "state", "why"), row, strict=True)) for row in rows])
        return
    from kincal.pipeline.report.tables import Table

    show_table(Table(("stage", "state", "why"), tuple(rows)), align="left")


@app.command
def predict(
    robot: Robot, *, joints: Path, method: str = "hybrid", json: JsonInstead = False, common: Common = COMMON
) -> None:
    """Measured-like poses, with sigma, at given actuator readings; a CSV table on stdout.

    Parameters
    ----------
    joints
        A CSV or Parquet table with one column a joint, as in the measurement table.
    method
        One of the methods that `compare` lists.
    """
    from kincal.pipeline.interface.queries import predicted_table

    print_table(predicted_table(opened(robot, common), joints, method), json)


@app.command
def compensate(
    robot: Robot, *, poses: Path, method: str = "hybrid", json: JsonInstead = False, common: Common = COMMON
) -> None:
    """Joint commands that reach the given poses; a CSV table on stdout.

    Parameters
    ----------
    poses
        A CSV or Parquet table of desired poses in the measurement frame: the columns of a measurement table.
    method
        One of the methods that `compare` lists.
    """
    from kincal.pipeline.interface.queries import compensated_table

    print_table(compensated_table(opened(robot, common), poses, method), json)


@app.command
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
    """The methods against a measurement table that no stage has seen.

    Parameters
    ----------
    data
        The measurement table, CSV or Parquet.
    columns
        A TOML file with a column map of its own, as [measure.columns] has it.
    register
        First refit W alone: the instrument was set up anew.
    rehome
        First refit the actuator zeros: the robot was homed anew.
    """
    from kincal.pipeline.interface.queries import evaluated

    session = opened(robot, common)
    compared = evaluated(session, data, columns, register=register, rehome=rehome)
    if json:
        from kincal.pipeline.run.changes import file_digest
        from kincal.pipeline.run.provenance import provenance

        found = provenance(session.entries, ["identify", "transfer", "correct"], session.command)
        files = {"data": data} | ({"columns": columns} if columns else {})
        found["files"] |= {name: file_digest(file) for name, file in files.items()}
        print_json(asdict(compared) | {"provenance": found})
    else:
        show_comparison(compared)


@app.command
def init(drawing: Path, *, output: Path | None = None) -> None:
    """Propose a robot.toml for a URDF or an MJCF: loops, actuators and a workspace, with the reasons in comments.

    Parameters
    ----------
    drawing
        The URDF or MJCF file.
    output
        The file to write, which must not exist (default: robot.toml beside the drawing).
    """
    from kincal.urdf.proposed_toml import write_proposal

    written = write_proposal(drawing, output)
    for remark in written.remarks:
        err.print(Text(f"note: {remark}", style="yellow"), soft_wrap=True)
    out.print(Text(f"{short(written.file)}: {written.summary}"), soft_wrap=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command and exit: 0 done, 1 the calibration failed its own checks, 2 bad input."""
    sys.exit(_status(lambda: app(arguments, exit_on_error=False, print_error=False)))


def _status(call: Callable[[], Any]) -> int:
    try:
        call()
        sys.stdout.flush()
    except CycloptsError as error:
        return _say(str(error).splitlines()[0], 2)
    except InputError as error:
        return _say(str(error), 2)
    except CalibrationError as error:
        return _say(str(error), 1)
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except OSError as error:
        if error.filename is None:  # the output: what it has not taken is not written once more at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _say(of_system(error), 2)
    return 0


def _say(message: str, code: int) -> int:
    err.print(Text("kincal: " + one_line(message)), soft_wrap=True)
    return code


if __name__ == "__main__":
    main()
