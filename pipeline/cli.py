"""The command `kincal`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter
from rich.text import Text

from pipeline.console import (
    Progress,
    aside,
    err,
    out,
    print_json,
    print_table,
    short,
    show_comparison,
    show_inspection,
    show_table,
)
from urdf.errors import CalibrationError, InputError

app = App(
    name="kincal",
    help="Calibrates closed-chain (parallel) robots from a handful of measured poses.",
    help_format="plaintext",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # main says so
)


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Options that every command has."""

    set: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None
    """Override one value of robot.toml: table.key=value, in TOML syntax; may be repeated."""
    store: Path = Path(".kincal")
    """The folder of cached artifacts."""


Json = Annotated[bool, Parameter(name="--json", negative=())]


@app.command
def run(
    robot: str,
    *,
    until: str = "report",
    force_from: str | None = None,
    json: Json = False,
    common: Common | None = None,
) -> None:
    """Run the staged pipeline, and end with the comparison.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    until
        The last stage to run.
    force_from
        Run this stage and all after it, cached or not.
    json
        The comparison as one JSON document on stdout.
    """
    session = _session(robot, common, force_from)
    if until != "report":
        session.until(until)
        return
    compared, report = session.until("evaluate", "report")
    page = session.store.publish(session.robot_id, report.html.file, report.html.encode())
    if json:
        print_json(_comparison_json(compared))
        return
    show_comparison(compared)
    out.print(Text(f"report: {short(page)}"))


@app.command
def compare(robot: str, *others: str, json: Json = False, common: Common | None = None) -> None:
    """The methods side by side on the same held-out poses.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    others
        More robots.
    json
        One JSON document on stdout; a list where there are several robots.
    """
    compared = [_session(name, common).until("evaluate")[0] for name in (robot, *others)]
    if json:
        documents = [_comparison_json(c) for c in compared]
        print_json(documents if others else documents[0])
    else:
        for c in compared:
            show_comparison(c)


@app.command
def inspect(
    robot: str,
    *,
    before: Annotated[bool, Parameter(negative=())] = False,
    plot: Path | None = None,
    json: Json = False,
    common: Common | None = None,
) -> None:
    """Every parameter: nominal, identified, change, sigma; what could not be seen, and how sure the rest is.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    before
        From the planned poses and the sensors alone, before anybody measures.
    plot
        Draw singular values, shares and changes into this .svg, .png or .pdf file.
    json
        One JSON document on stdout.
    """
    from pipeline.tables import foreseen_json, parameters_json

    session = _session(robot, common)
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
def status(robot: str, *, json: Json = False, common: Common | None = None) -> None:
    """Which stages are fresh, which are stale, and what made them so.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    json
        One JSON document on stdout.
    """
    rows = list(_session(robot, common).status())
    if json:
        print_json([dict(zip(("stage", "state", "why"), row, strict=True)) for row in rows])
        return
    from pipeline.tables import Table

    show_table(Table(("stage", "state", "why"), tuple(rows)), align="left")


@app.command
def predict(
    robot: str, *, joints: Path, method: str = "hybrid", json: Json = False, common: Common | None = None
) -> None:
    """Measured-like poses, with sigma, at given actuator readings; a CSV table on stdout.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    joints
        A CSV or Parquet table with one column a joint, as in the measurement table.
    method
        One of the methods that `compare` lists.
    json
        One JSON document on stdout instead.
    """
    from pipeline.queries import predicted_table

    print_table(predicted_table(_session(robot, common), joints, method), json)


@app.command
def compensate(
    robot: str, *, poses: Path, method: str = "hybrid", json: Json = False, common: Common | None = None
) -> None:
    """Joint commands that reach the given poses; a CSV table on stdout.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    poses
        A CSV or Parquet table of desired poses in the measurement frame: the columns of a measurement table.
    method
        One of the methods that `compare` lists.
    json
        One JSON document on stdout instead.
    """
    from pipeline.queries import compensated_table

    print_table(compensated_table(_session(robot, common), poses, method), json)


@app.command
def evaluate(
    robot: str,
    *,
    data: Path,
    columns: Path | None = None,
    register: Annotated[bool, Parameter(negative=())] = False,
    rehome: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
    common: Common | None = None,
) -> None:
    """The methods against a measurement table that no stage has seen.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    data
        The measurement table, CSV or Parquet.
    columns
        A TOML file with a column map of its own, as [measure.columns] has it.
    register
        First refit W alone: the instrument was set up anew.
    rehome
        First refit the actuator zeros: the robot was homed anew.
    json
        One JSON document on stdout.
    """
    from pipeline.queries import evaluated

    compared = evaluated(_session(robot, common), data, columns, register=register, rehome=rehome)
    if json:
        print_json(_comparison_json(compared))
    else:
        show_comparison(compared)


@app.command
def export(
    robot: str,
    *,
    format: Literal["urdf", "json"],
    output: Path | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
    common: Common | None = None,
) -> None:
    """The calibrated robot for others, read back and checked against the identified model before it is handed out.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    format
        urdf: a folder with robot.urdf, robot.toml and parameters.csv; json: one document.
    output
        The folder (default: NAME_calibrated), or the file of the document (default: stdout).
    force
        Write also where something stands that export has not made.
    """
    from pipeline.export import export_document, export_folder

    session = _session(robot, common)
    if format == "json":
        exported = export_document(session, output, force)
        if output is None:
            print_json(exported.document)
            return
    else:
        exported = export_folder(session, output, force)
    if exported.note:
        err.print(Text(f"note: {exported.note}", style="yellow"), soft_wrap=True)
    within = f"within {exported.position:.1e} m and {exported.rotation:.1e} rad at {exported.n_checked} readings"
    out.print(Text(f"{exported.path}: predicts as the identified model does, {within}"), soft_wrap=True)
    if exported.target:
        out.print(Text(f"what is measured: the pose of link {exported.target!r} in link {exported.instrument!r}"))


@app.command
def plan(
    robot: str,
    *,
    poses: int | None = None,
    layout: Literal["d_optimal", "grid", "random"] | None = None,
    accuracy: float | None = None,
    accuracy_mm: float | None = None,
    output: Path | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
    common: Common | None = None,
) -> None:
    """Which poses to measure: a CSV table for the operator on stdout, and on stderr what they will tell.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    poses
        How many; default: as many as --accuracy needs, else plan.poses of robot.toml.
    layout
        Default: plan.layout of robot.toml, else d_optimal.
    accuracy
        Say how many poses each layout needs for this mean error [deg] of the identified model.
    accuracy_mm
        The same for the position [mm].
    output
        Write the table to this .csv or .parquet file instead.
    force
        Write it also where a file of this name stands.
    json
        One JSON document on stdout instead.
    """
    from pipeline.planning import Wanted, check_output, layout_table, needed_table, plan_json, plan_report, write_table

    if output is not None:
        check_output(output, force)
    wanted = None if accuracy is None and accuracy_mm is None else Wanted(accuracy, accuracy_mm)
    report = plan_report(_session(robot, common), layout, poses, wanted)
    if output is not None:
        write_table(report.table, output)
    if json:
        print_json(plan_json(report))
        return
    channels = ", ".join(report.channels)
    err.print(f"{report.robot}: {len(report.table)} poses, measured {channels}; as predicted:", style="bold")
    show_table(layout_table(report.scores), console=aside)
    if wanted is not None:
        err.print(f"poses for a predicted mean error of {wanted}:", style="bold")
        show_table(needed_table(report), console=aside)
    if output is None:
        print_table(report.table, False)


@app.command
def sweep(
    robot: str,
    *,
    over: Annotated[list[str] | None, Parameter(name="--over", negative=())] = None,
    seeds: int = 1,
    on: str = "1",
    output: Path | None = None,
    json: Json = False,
    common: Common | None = None,
) -> None:
    """The comparison over a grid of settings and seeds: one table of all, and the medians over seeds.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    over
        A setting and its values: table.key=10,20,...,210, in TOML syntax; repeated, every combination.
    seeds
        How many seeds, from 0; 1: the robot's own.
    on
        How many worker processes; 1: this process.
    output
        The folder of sweep.parquet and sweep.svg (default: the robot's folder in the store).
    json
        One JSON document on stdout.
    """
    from pipeline.executor import worker_count
    from pipeline.sweep import median_tables, output_folder, plan_sweep, sweep_json, write
    from pipeline.sweep import sweep as swept_on
    from pipeline.sweep_progress import SweepProgress

    n_workers, common = worker_count(on), common or Common()
    overs, points = plan_sweep(robot, over or (), seeds, common.set or (), common.store, _command())
    session = _session(robot, common)
    folder = output_folder(output, session.store.root / "robots" / session.robot_id)
    valid = [p for p in points if not isinstance(p.robot, InputError)]
    labels = {p.job: " ".join(f"{key}={value}" for key, value in p.values.items()) for p in valid}
    with SweepProgress(session.robot.description.name, labels) as progress:
        found = swept_on(overs, points, n_workers, progress)
    table, figure = write(found, folder)
    if json:
        print_json(sweep_json(found, table, figure))
    else:
        for title, medians in median_tables(found):
            out.print(Text(f"{found.robot}: {title}", style="bold"))
            show_table(medians)
        for what, file in (("table", table), ("figure", figure)):
            if file is not None:
                out.print(Text(f"{what}: {short(file)}"), soft_wrap=True)
    found.check()


@app.command
def reproduce(
    *,
    seeds: int = 10,
    on: str = "2",
    output: Path = Path("reproduced"),
    json: Json = False,
    common: Common | None = None,
) -> None:
    """The simulation of Xu, Tian and Zhang 2024 on ups3_s: every table and figure, all methods, the paper's numbers.

    Parameters
    ----------
    seeds
        How many seeds, from 0: each draws robot, noise, split and networks.
    on
        How many worker processes; 1: this process.
    output
        The folder of index.html, the figures, the tables and results.json.
    json
        The contents of results.json on stdout.
    """
    from pipeline.executor import worker_count
    from pipeline.reproduce import plan as planned
    from pipeline.reproduce import reproduce as reproduced
    from pipeline.reproduce import study_of
    from pipeline.sweep import output_folder
    from pipeline.sweep_progress import SweepProgress

    n_workers, common, study = worker_count(on), common or Common(), study_of(seeds)
    robot, jobs = planned(study, common.set or (), common.store, _command())
    folder = output_folder(output, output)
    with SweepProgress(robot.name, {job: str(point) for job, point in jobs.items()}) as progress:
        found = reproduced(study, robot, jobs, n_workers, progress)
    from pipeline.reproduction_page import findings, summary, write

    made = findings(found)
    page = write(found, made, folder)
    if json:
        print_json(made.document)
        return
    for title, table in summary(made.document):
        out.print(Text(title, style="bold"))
        show_table(table)
    for verdict in made.document["verdicts"]:
        out.print(Text(verdict), soft_wrap=True)
    out.print(Text(f"page: {short(page)}"), soft_wrap=True)


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


def _session(robot: str, common: Common | None, force_from: str | None = None):
    from pipeline.artifacts import Store
    from pipeline.runner import Run, all_stages
    from urdf.description import load_robot, nearest

    common = common or Common()
    if force_from is not None and force_from not in all_stages():
        raise InputError(f"--force-from {force_from}: no such stage; {nearest(force_from, all_stages())}")
    loaded = load_robot(robot, common.set or ())
    return Run(loaded, Store(common.store), force_from, Progress(loaded.description.name), _command())


def _command() -> str:
    return shlex.join(["kincal", *sys.argv[1:]])


def _comparison_json(compared) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(compared)


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
    err.print(Text("kincal: " + " ".join(message.split())), soft_wrap=True)
    return code


if __name__ == "__main__":
    main()
