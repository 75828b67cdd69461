"""The command `kincal columns`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

from rich.text import Text

from kincal.pipeline.commands.console import out, print_json, say, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, JsonInstead, Robot


def columns(
    file: Path,
    robot: Robot | None = None,
    *,
    write: Flag = False,
    output: Path | None = None,
    force: Flag = False,
    json: JsonInstead = False,
    common: Common = COMMON,
) -> None:
    """Show how a table is written and what kincal takes each column for, before you calibrate with it.

    Parameters
    ----------
    file
        A measurement table, or an export of Motive or Qualisys Track Manager.
    robot
        Whose table it is, so that the columns of the joints are known.
    write
        Print the column map instead, as [measure.columns] of robot.toml.
    output
        Write the column map to this .toml file instead.
    force
        Replace the output file if it exists.
    """
    from kincal.pipeline.interface.columns import map_as_toml, recognise, write_map
    from kincal.pipeline.report.column_tables import closing_lines, column_table

    report = recognise(file, robot, common.overrides)
    if output is not None:
        out.print(Text(f"{short(write_map(report, output, force))}: the column map of {file.name}"), soft_wrap=True)
    elif write:
        sys.stdout.write(map_as_toml(report))
    elif json:
        document = asdict(report) | {"file": str(file), "facts": [list(fact) for fact in report.facts]}
        document["column_map"] = {n: c.model_dump(by_alias=True) for n, c in report.column_map.items()}
        print_json(document, "columns")
    else:
        say(f"{file}: {report.rows} rows", "bold")
        for key, value in report.facts:
            say(f"{key}: {value}")
        show_table(column_table(report), align="left")
        for line in closing_lines(report, robot is not None):
            say(line, "yellow")
