"""The command `kincal`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter
from rich.text import Text

from pipeline import sea_commands, study_commands
from pipeline.console import err, out, print_json, print_table, short, show_comparison, show_inspection, show_table
from pipeline.options import COMMON, Common, Flag, Json, JsonInstead, Robot, opened
from urdf.errors import CalibrationError, InputError, one_line

app = App(
    name="kincal",
    help="Calibrates closed-chain (parallel) robots from a handful of measured poses.",
    help_format="plaintext",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # main says so
)
for _command in (study_commands.export, study_commands.plan, study_commands.sweep, study_commands.reproduce):
    app.command(_command)
app.command(sea_commands.sea_trial)


@app.command
def run(
    robot: Robot,
    *,
    until: str = "report",
    force_from: str | None = None,
    json: Annotated[Json, Parameter(help="The comparison as one JSON document on stdout.")] = False,
    common: Common = COMMON,
) -> None:
    """Run the staged pipeline, and end with the comparison.

    Parameters
    ----------
    until
        The last stage to run.
    force_from
        Run this stage and all after it, cached or not.
    """
    session = opened(robot, common, force_from)
    if until != "report":
        session.until(until)
        return
    compared, report = session.until("evaluate", "report")
    page = session.store.publish(session.robot_id, report.html.file, report.html.encode())
    if json:
        print_json(asdict(compared))
        return
    show_comparison(compared)
    out.print(Text(f"report: {short(page)}"))


@app.command
def compare(
    robot: Robot,
    *others: str,
    json: Annotated[
        Json, Parameter(help="One JSON document on stdout; a list where there are several robots.")
    ] = False,
    common: Common = COMMON,
) -> None:
    """The methods side by side on the same held-out poses.

    Parameters
    ----------
    others
        More robots.
    """
    compared = [opened(name, common).until("evaluate")[0] for name in (robot, *others)]
    if json:
        documents = [asdict(c) for c in compared]
        print_json(documents if others else documents[0])
    else:
        for c in compared:
            show_comparison(c)


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
    from pipeline.tables import foreseen_json, parameters_json

    session = opened(robot, common)
    name, more, foresight = session.robot.description.name, {}, None
    if before:
        from pipeline.foresight import foresee

        foresight = foresee(session)
        found, more = foresight.identification, foresight.json()
    else:
        found = session.until("identify")[0].shipped
    if plot is not None:
        from pipeline.identification_figures import draw

        draw(found, plot, before)
    if json:
        print_json(foreseen_json(name, found, more) if before else parameters_json(name, found))
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
    from pipeline.tables import Table

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
    from pipeline.queries import predicted_table

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
    from pipeline.queries import compensated_table

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
    from pipeline.queries import evaluated

    compared = evaluated(opened(robot, common), data, columns, register=register, rehome=rehome)
    if json:
        print_json(asdict(compared))
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
    from urdf.proposed_toml import write_proposal

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
    return 0


def _say(message: str, code: int) -> int:
    err.print(Text("kincal: " + one_line(message)), soft_wrap=True)
    return code


if __name__ == "__main__":
    main()
