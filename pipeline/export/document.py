"""The identified robot as one JSON document, read back and checked before it is handed out."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path

from kincal.pipeline.export.calibration_json import SCHEMA, calibration_document, read_calibration
from kincal.pipeline.export.identified import Exported, agreement, identified_robot
from kincal.pipeline.export.target import check_parent
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import version
from kincal.pipeline.store.files import refusing, replace_file
from kincal.urdf.errors import InputError


def export(session: Run, output: Path | None = None, force: bool = False, method: str | None = None) -> Exported:
    """The calibrated robot as one JSON document, written to `output` where that is given."""
    _check_file_free(output, force)
    calibrated = identified_robot(session)
    document = calibration_document(
        calibrated.description, calibrated.robot, calibrated.found, calibrated.measured, _versions()
    )
    document |= {"provenance": dict(calibrated.provenance)}
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    robot = read_calibration(json.loads(text))
    closure = robot.close(calibrated.readings)
    apart = agreement(calibrated, closure.closed, closure.pose, robot.measured(closure.pose))
    if output is not None:
        _check_file_free(output, force)
        with refusing(f"--output {output}"):
            replace_file(output, text.encode())
    return Exported(output, document, len(calibrated.readings), *apart)


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("kincal", "pin", "numpy")} | {"python": platform.python_version()}


def _check_file_free(output: Path | None, force: bool) -> None:
    if output is None:
        return
    with refusing(f"--output {output}"):
        check_parent(output)
        if not os.path.lexists(output):
            return
        if not output.is_file():
            raise InputError(f"--output {output}: no file; allowed is a new file")
        if not force and not _is_calibration(output):
            raise InputError(
                f"--output {output}: exists, and was not made by kincal export; name a new file, or replace it with "
                "--force"
            )


def _is_calibration(file: Path) -> bool:
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("schema") == SCHEMA
