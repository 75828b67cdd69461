"""What the commands write: results on stdout, progress and remarks on stderr."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

# A fixed width: a pipe has none, and a terminal wraps a long line better than rich cuts a table.
out = Console(highlight=False, width=300)
aside = Console(stderr=True, highlight=False, width=300)  # tables on stderr


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
