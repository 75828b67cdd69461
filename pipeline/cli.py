"""The command `kincal`."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from urdf.errors import CalibrationError, InputError

app = App(
    name="kincal",
    help="Calibrates closed-chain (parallel) robots from a handful of measured poses.",
    help_format="plaintext",
    version_flags=["--version"],
)
# A fixed width: a pipe has none, and a terminal wraps a long line better than rich cuts a table.
out = Console(highlight=False, width=300)
err = Console(stderr=True, highlight=False)


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
        _print_json(_comparison_json(compared))
        return
    _show_comparison(compared)
    out.print(Text(f"report: {_short(page)}"))


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
        _print_json(documents if others else documents[0])
    else:
        for c in compared:
            _show_comparison(c)


@app.command
def inspect(robot: str, *, json: Json = False, common: Common | None = None) -> None:
    """Every parameter: nominal, identified, change, sigma; what could not be seen.

    Parameters
    ----------
    robot
        A shipped robot's name, or the path to a robot.toml.
    json
        One JSON document on stdout.
    """
    from pipeline.tables import parameter_table, parameters_json

    session = _session(robot, common)
    found = session.until("identify")[0].shipped
    name = session.robot.description.name
    if json:
        _print_json(parameters_json(name, found))
        return
    out.print(f"{name}: parameters identified from {found.n_poses} poses ({', '.join(found.channels)})", style="bold")
    _show_table(parameter_table(found))
    out.print(
        f"rank {found.rank} of {len(found.names)} parameters, condition number {found.condition_number:.3g}; "
        f"chi-square {found.chi_square:.4g} over {found.degrees_of_freedom:.1f} degrees of freedom"
    )
    out.print(f"{len(found.unobservable)} unobservable directions:")
    for direction in found.unobservable:
        out.print(Text(f"  {direction}"))
    _show_outliers(found)


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
        _print_json([dict(zip(("stage", "state", "why"), row, strict=True)) for row in rows])
        return
    from pipeline.tables import Table

    _show_table(Table(("stage", "state", "why"), tuple(rows)), align="left")


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

    _print_table(predicted_table(_session(robot, common), joints, method), json)


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

    _print_table(compensated_table(_session(robot, common), poses, method), json)


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
        _print_json(_comparison_json(compared))
    else:
        _show_comparison(compared)


def _session(robot: str, common: Common | None, force_from: str | None = None):
    from pipeline.artifacts import Store
    from pipeline.runner import Run, all_stages
    from urdf.description import load_robot, nearest

    common = common or Common()
    if force_from is not None and force_from not in all_stages():
        raise InputError(f"--force-from {force_from}: no such stage; {nearest(force_from, all_stages())}")
    loaded = load_robot(robot, common.set or ())
    command = shlex.join(["kincal", *sys.argv[1:]])
    return Run(loaded, Store(common.store), force_from, _Progress(loaded.description.name), command)


class _Progress:
    """Progress by stage, live in a terminal, plain lines elsewhere; always on stderr."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._live = None

    def __call__(self, event) -> None:
        why = f"  ({event.why})" if event.why else ""
        label = f"{self._robot} {event.stage:<9}"
        if event.state == "running":
            if err.is_terminal:
                self._live = err.status(Text(f"{label} running{why}"))
                self._live.start()
            return
        if self._live is not None:
            self._live.stop()
            self._live = None
        if event.state == "damaged":
            err.print(
                Text(f"warning: {event.why}; set aside, {event.stage} runs again", style="yellow"), soft_wrap=True
            )
        else:
            seconds = "" if event.seconds is None else f" {event.seconds:6.2f} s"
            style = "dim" if event.state == "cached" else ""
            err.print(Text(f"{label} {event.state:<6}{seconds}{why}", style=style), soft_wrap=True)

    def stop(self) -> None:
        if self._live is not None:
            self._live.stop()


def _comparison_json(compared) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(compared)


def _show_comparison(compared) -> None:
    from pipeline.tables import comparison_tables

    source = "virtual robot" if compared.source == "virtual" else compared.source
    scored = {
        "fresh": f"{compared.n_scored} fresh poses, noise-free truth",
        "held_out": f"{compared.n_scored} measured poses, each held out once (cross-validation)",
    }.get(compared.scored_on, f"{compared.scored_on}, {compared.n_scored} poses")
    out.print(Text(f"{compared.robot}: {compared.n_poses} measured poses ({source}), scored on {scored}", style="bold"))
    for table in comparison_tables(compared.methods, compared.raw_nominal):
        _show_table(table)
    if compared.closed_loop:
        out.print(Text("after compensation, where the virtual robot is against where it should be", style="bold"))
        for table in comparison_tables(compared.closed_loop):
            _show_table(table)
        for name, n in compared.not_reached.items():
            out.print(f"{name} has no command for {n} of the desired poses; its row is of the others")


def _show_table(table, align: Literal["left", "right"] = "right") -> None:
    shown = RichTable(box=None, pad_edge=False, header_style="bold")
    for k, column in enumerate(table.columns):
        shown.add_column(Text(column), justify="left" if k == 0 else align, no_wrap=True)
    for row in table.rows:
        shown.add_row(*(Text(cell) for cell in row))
    out.print(shown)


def _show_outliers(found) -> None:
    for outlier in found.outliers:
        out.print(f"outlier: pose {outlier.pose}: {outlier.reason}")


def _print_table(table, as_json: bool) -> None:
    if as_json:
        _print_json(table.to_dict(orient="records"))
    else:
        sys.stdout.write(table.to_csv(index=False))


def _print_json(document: Any) -> None:
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


def _short(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


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
