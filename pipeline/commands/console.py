"""What the commands write: results on stdout, progress and remarks on stderr."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

# A fixed width: a pipe has none, and a terminal wraps a long line better than rich cuts a table.
out = Console(highlight=False, width=300)
err = Console(stderr=True, highlight=False)
aside = Console(stderr=True, highlight=False, width=300)  # tables on stderr


class Progress:
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
        if event.state == "noted":
            err.print(Text(f"warning: {event.why}", style="yellow"), soft_wrap=True)
        elif event.state == "damaged":
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


def show_comparison(compared) -> None:
    from kincal.pipeline.report.tables import comparison_tables

    source = "virtual robot" if compared.source == "virtual" else compared.source
    scored = {
        "fresh": f"{compared.n_scored} fresh poses, noise-free truth",
        "held_out": f"{compared.n_scored} measured poses, each held out once (cross-validation)",
    }.get(compared.scored_on, f"{compared.scored_on}, {compared.n_scored} poses")
    out.print(Text(f"{compared.robot}: {compared.n_poses} measured poses ({source}), scored on {scored}", style="bold"))
    for table in comparison_tables(compared.methods, compared.raw_nominal):
        show_table(table)
    if compared.closed_loop:
        out.print(Text("after compensation, where the virtual robot is against where it should be", style="bold"))
        for table in comparison_tables(compared.closed_loop):
            show_table(table)
        for name, n in compared.not_reached.items():
            out.print(f"{name} has no command for {n} of the desired poses; its row is of the others")
    if compared.advice is not None:
        out.print(Text(compared.advice.text), soft_wrap=True)


def show_table(table, align: Literal["left", "right"] = "right", console: Console = out) -> None:
    shown = RichTable(box=None, pad_edge=False, header_style="bold")
    for k, column in enumerate(table.columns):
        shown.add_column(Text(column), justify="left" if k == 0 else align, no_wrap=True)
    for row in table.rows:
        shown.add_row(*(Text(cell) for cell in row))
    console.print(shown)


def print_table(table, as_json: bool) -> None:
    if as_json:
        print_json(table.to_dict(orient="records"))
    else:
        sys.stdout.write(table.to_csv(index=False))


def print_json(document: Any) -> None:
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


def short(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def show_inspection(name: str, found, foresight) -> None:
    """An identification; or, before anybody has measured, what it will be."""
    from kincal.pipeline.report.tables import foreseen_table, parameter_table, summary_lines

    if foresight is not None:
        out.print(Text(f"{name}: what {found.n_poses} planned poses will tell ({', '.join(found.channels)})", "bold"))
        show_table(foreseen_table(found))
        lines = [*summary_lines(found), *foresight.lines()]
    else:
        poses = f"{found.n_poses} poses ({', '.join(found.channels)})"
        out.print(Text(f"{name}: parameters identified from {poses} by {found.estimator}, {found.loss} loss", "bold"))
        show_table(parameter_table(found))
        sigmas = "; ".join(f"{c} {_sigma(c, v)}" for c, v in found.sensor_std.items())
        estimated = f" ({', '.join(found.sensor_estimated)} estimated from residuals)" if found.sensor_estimated else ""
        lines = [
            *summary_lines(found),
            f"sensors, one sigma: {sigmas}{estimated}",
            f"chi-square {found.chi_square:.4g} over {found.degrees_of_freedom:.1f} degrees of freedom; "
            f"{found.message} after {found.iterations} iterations, shrinkage {found.shrinkage:.3g}",
        ]
    lines.append(f"{len(found.unobservable)} unobservable directions:")
    lines += [f"  {direction}" for direction in found.unobservable]
    lines += [f"finding: {finding}" for finding in found.findings]
    lines += [f"outlier: pose {outlier.pose}: {outlier.reason}" for outlier in found.outliers]
    for line in lines:
        out.print(Text(line), soft_wrap=True)


def _sigma(channel: str, sigma: float) -> str:
    return f"{1e3 * sigma:.3g} mm" if channel == "position" else f"{math.degrees(sigma):.3g} deg"
