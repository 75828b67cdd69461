"""`kincal export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import note_virtual, out, print_json
from kincal.pipeline.commands.options import COMMON, Common, Flag, Robot, opened
from kincal.pipeline.interface.calibration import export_formats
from kincal.pipeline.interface.progress import err

_FORMATS = "; ".join(f"{name}: {text}" for name, text in export_formats().items()) + "."


def export(
    robot: Robot,
    *,
    format: Annotated[str, Parameter(help=_FORMATS)],
    method: str | None = None,
    output: Path | None = None,
    force: Flag = False,
    common: Common = COMMON,
) -> None:
    """Write the calibrated robot as URDF, JSON or C. The files are read back and checked first.

    Parameters
    ----------
    method
        Of the compensator: hybrid (default) or geometric.
    output
        The folder (default: NAME_calibrated, NAME_compensator), or the file of the document (default: stdout).
    force
        Write into an existing folder or file that export did not make.
    """
    calibration = opened(robot, common)
    exported = calibration.export(output, format=format, method=method, force=force)
    note_virtual(calibration.robot.description)
    if exported.path is None:
        print_json(exported.document)
        return
    if exported.note:
        err.print(Text(f"note: {exported.note}", style="yellow"), soft_wrap=True)
    for line in exported.lines:
        out.print(Text(line), soft_wrap=True)
