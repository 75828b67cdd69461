"""`kincal export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.text import Text

from kincal.pipeline.commands.console import out, print_json
from kincal.pipeline.commands.options import COMMON, Common, Flag, Robot, opened
from kincal.pipeline.interface.progress import err

if TYPE_CHECKING:
    from kincal.pipeline.interface.calibration import Exported, ExportedCode


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
    calibration = opened(robot, common)
    if format == "c":
        _show_code(calibration.export(output, format=format, method=method, force=force))
        return
    exported = calibration.export(output, format=format, method=method, force=force)
    if format == "json" and output is None:
        print_json(exported.document)
    else:
        _show_model(exported)


def _show_model(exported: Exported) -> None:
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
