"""What the commands write: results on stdout, progress and remarks on stderr."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from kincal.pipeline.interface.progress import err
from kincal.urdf.errors import CalibrationError


class PipedConsole(Console):
    """A console whose reader may close the pipe."""

    def on_broken_pipe(self) -> None:
        """Whoever reads has seen enough: `kincal .. | head` is no error (rich would exit with 1)."""
        raise BrokenPipeError


# a fixed width: a pipe has none, and a terminal wraps a long line better than rich cuts a table
out = PipedConsole(highlight=False, width=300)
aside = PipedConsole(stderr=True, highlight=False, width=300)  # tables on stderr


def say(text: str, style: str = "") -> None:
    """A line on stdout; a terminal gets it wrapped between words, a file or a pipe as one line."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    out.print(Text(text, style=style), width=width, soft_wrap=width is None)


def show_comparison(compared) -> None:
    """The methods side by side, and the recommendation."""
    from kincal.pipeline.report.tables import comparison_tables

    source = "virtual robot" if compared.source == "virtual" else compared.source
    scored = {
        "fresh": f"error at {compared.n_scored} fresh poses, without noise",
        "held_out": f"error at {compared.n_scored} measured poses, each held out once (cross-validation)",
    }.get(compared.scored_on, f"error at {compared.n_scored} poses of {compared.scored_on}")
    say(f"{compared.robot}: calibrated with {compared.n_poses} poses ({source})", "bold")
    say(f"Methods, {scored}")
    for table in comparison_tables(compared.methods, compared.raw_nominal):
        show_table(table)
    if compared.closed_loop:
        say("Error after compensation (virtual robot)")
        for table in comparison_tables(compared.closed_loop):
            show_table(table)
        for name, n in compared.not_reached.items():
            say(f"{name} reaches all but {n} of the desired poses; its row leaves those out")
    if compared.advice is not None:
        say(compared.advice.text)
    elif compared.helps_nowhere:
        say(
            "Finding: no method is better than nominal at these poses. If the instrument or the robot was set up anew "
            "since the calibration, try --register or --rehome.",
            "yellow",
        )


def note_virtual(description) -> None:
    """Say on stderr that a result is a virtual robot's, where the result itself has no place for it."""
    if description.measure.virtual:
        name = description.name
        err.print(Text(f"note: {name} is a virtual robot: its errors are simulated, not measured.", style="yellow"))


def show_findings(fit) -> None:
    """What to check before the result is used: findings, then outliers."""
    from kincal.pipeline.report.inspection import finding_lines

    outliers = [(o.pose, o.reason) for o in fit.identification.outliers]
    for line in finding_lines(fit.findings, outliers):
        say(line, "yellow")


def show_verdict(verdict) -> None:
    """Pass or fail, where limits are set. Raises CalibrationError for fail."""
    if verdict is not None and verdict.passed:
        say(verdict.line, "bold green")
    check_verdict(verdict)


def check_verdict(verdict) -> None:
    """Raises CalibrationError where an error is above its limit."""
    if verdict is not None and not verdict.passed:
        raise CalibrationError(verdict.line)


def show_table(table, align: Literal["left", "right"] = "right", console: Console = out) -> None:
    """A table; where it is too wide, columns are one space apart, and units and words of headings stand below."""
    room = shutil.get_terminal_size().columns if console.is_terminal else 100
    headings, gap = table.columns, 2
    if _width(headings, table.rows, gap) > room:
        gap = 1
        if _width(headings, table.rows, gap) > room:
            headings = tuple(heading.replace(" ", "\n") for heading in headings)
    shown = RichTable(box=None, pad_edge=False, collapse_padding=gap == 1, header_style="bold")
    for k, column in enumerate(headings):
        shown.add_column(Text(column), justify="left" if k == 0 else align, no_wrap=True)
    for row in table.rows:
        shown.add_row(*(Text(cell) for cell in row))
    console.print(shown)


def _width(headings: Sequence[str], rows: Sequence[Sequence[str]], gap: int) -> int:
    widths = (max(map(len, column)) for column in zip(headings, *rows, strict=True))
    return sum(widths) + gap * (len(headings) - 1)


def print_table(table, as_json: bool) -> None:
    if as_json:
        print_json(table.to_dict(orient="records"))
    else:
        sys.stdout.write(table.to_csv(index=False))


def print_json(document: Any, kind: str = "") -> None:
    """One document on stdout; kind: what it is, for its schema id."""
    if kind and isinstance(document, dict):
        document = {"schema": f"kincal-{kind}-1", **document}
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


def short(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
