"""The commands of `kincal` around a calibration: which poses to measure, many runs at once, and what others get."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import aside, err, out, print_json, print_table, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, Json, JsonInstead, Robot, command_line, opened
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.pipeline.export.c_code import ExportedCode


def export(
    robot: Robot,
    *,
    format: Literal["urdf", "json", "c"],
    method: str | None = None,
    output: Path | None = None,
    force: Flag = False,
    common: Common = COMMON,
) -> None:
    """The calibrated robot for others, read back and checked against the identified model before it is handed out.

    Parameters
    ----------
    format
        urdf: a folder with robot.urdf, robot.toml and parameters.csv; json: one document; c: a folder with the
        compensator for a controller, one C file with its header and a test program.
    method
        Of the compensator: hybrid (default) or geometric.
    output
        The folder (default: NAME_calibrated, NAME_compensator), or the file of the document (default: stdout).
    force
        Write also where something stands that export has not made.
    """
    from kincal.pipeline.export.export import export_document, export_folder

    if method is not None and format != "c":
        raise InputError(f"--method {method}: --format {format} has none; allowed with --format c")
    session = opened(robot, common)
    if format == "c":
        from kincal.pipeline.export.c_code import export_code

        _show_code(export_code(session, method or "hybrid", output, force))
        return
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


def _show_code(exported: ExportedCode) -> None:
    agreed = exported.agreement
    within = f"within {agreed.command:.1e} m or rad of an actuator at {agreed.n_checked} poses"
    out.print(Text(f"{exported.path}: commands as kincal compensate does, {within}"), soft_wrap=True)
    out.print(Text(f"at most {exported.iterations} iterations a command, from any start"))
    if exported.compiler is None:
        note = (
            "note: there is no C compiler here; the code's steps were compared as CasADi evaluates them, not compiled"
        )
        err.print(Text(note, style="yellow"), soft_wrap=True)


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
    """Which poses to measure: a CSV table for the operator on stdout, and on stderr what they will tell.

    Parameters
    ----------
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
    """
    from kincal.pipeline.planning.layouts import (
        Wanted,
        check_output,
        layout_table,
        needed_table,
        plan_json,
        plan_report,
        write_table,
    )

    if output is not None:
        check_output(output, force)
    wanted = None if accuracy is None and accuracy_mm is None else Wanted(accuracy, accuracy_mm)
    report = plan_report(opened(robot, common), layout, poses, wanted)
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
    """The comparison over a grid of settings and seeds: one table of all, and the medians over seeds.

    Parameters
    ----------
    over
        A setting and its values: table.key=10,20,...,210, in TOML syntax; repeated, every combination.
    seeds
        How many seeds, from 0; 1: the robot's own.
    on
        How many worker processes (1: this process), or dask://host:port.
    output
        The folder of sweep.parquet and sweep.svg (default: the robot's folder in the store).
    """
    from kincal.pipeline.commands.job_progress import JobProgress
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.store.files import output_folder
    from kincal.pipeline.studies.medians import median_tables
    from kincal.pipeline.studies.sweep import plan_sweep
    from kincal.pipeline.studies.sweep import sweep as swept_on
    from kincal.pipeline.studies.sweep_files import sweep_json, write
    from kincal.pipeline.studies.used import Used

    where = place(on)
    overs, points = plan_sweep(robot, over or (), seeds, common.overrides, common.store, command_line())
    session = opened(robot, common)
    folder = output_folder(output, session.store.root / "robots" / session.robot_id)
    valid = [p for p in points if not isinstance(p.robot, InputError)]
    labels = {p.job: " ".join(f"{key}={value}" for key, value in p.values.items()) for p in valid}
    with JobProgress(session.robot.description.name, labels) as progress:
        used = Used(progress)
        found = swept_on(overs, points, where, used)
    found.table.attrs["provenance"] = used.provenance()
    table, figure = write(found, folder)
    used.finish(session, "sweep", table)
    if json:
        said = {"command": session.command} | used.provenance()
        print_json(sweep_json(found, table, figure) | {"provenance": said})
    else:
        for title, medians in median_tables(found):
            out.print(Text(f"{found.robot}: {title}", style="bold"))
            show_table(medians)
        for what, file in (("table", table), ("figure", figure)):
            if file is not None:
                out.print(Text(f"{what}: {short(file)}"), soft_wrap=True)
    found.check()


def reproduce(
    *,
    seeds: int = 10,
    on: str = "2",
    output: Path = Path("reproduced"),
    json: Annotated[Json, Parameter(help="The contents of results.json on stdout.")] = False,
    common: Common = COMMON,
) -> None:
    """The simulation of Xu, Tian and Zhang 2024 on ups3_s: every table and figure, all methods, the paper's numbers.

    Parameters
    ----------
    seeds
        How many seeds, from 0: each draws robot, noise, split and networks.
    on
        How many worker processes (1: this process), or dask://host:port.
    output
        The folder of index.html, the figures, the tables and results.json.
    """
    from kincal.pipeline.commands.job_progress import JobProgress
    from kincal.pipeline.reproduce.study import ROBOT, study_of
    from kincal.pipeline.reproduce.study import plan as planned
    from kincal.pipeline.reproduce.study import reproduce as reproduced
    from kincal.pipeline.run.executor import place
    from kincal.pipeline.store.files import output_folder
    from kincal.pipeline.studies.used import Used

    where, study = place(on), study_of(seeds)
    robot, jobs = planned(study, common.overrides, common.store, command_line())
    folder = output_folder(output, output)
    with JobProgress(robot.name, {job: str(point) for job, point in jobs.items()}) as progress:
        used = Used(progress)
        found = reproduced(study, robot, jobs, where, used)
    from kincal.pipeline.reproduce.page import findings, summary, write

    made = findings(found)
    made.document["provenance"] = used.provenance()
    page = write(found, made, folder)
    used.finish(opened(ROBOT, common), "reproduce", page, found.made_beyond)
    if json:
        print_json(made.document)
        return
    for title, table in summary(made.document):
        out.print(Text(title, style="bold"))
        show_table(table)
    for verdict in made.document["verdicts"]:
        out.print(Text(verdict), soft_wrap=True)
    out.print(Text(f"page: {short(page)}"), soft_wrap=True)
