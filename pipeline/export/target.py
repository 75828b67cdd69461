"""Where an export goes: what stands there is replaced if export made it, and nothing is left half-written."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kincal.pipeline.results import VIRTUAL
from kincal.pipeline.store.files import refusing
from kincal.urdf.description import Robot
from kincal.urdf.errors import InputError

MADE_HERE = "kincal export: "  # begins, as a comment, the first line of a file that says who made its folder


def check_folder_free(output: Path, robot: Robot, force: bool, marker: Path) -> None:
    """InputError where `output` is no folder to write into; marker: the file in it that says who made it."""
    with refusing(f"--output {output}"):
        check_parent(output)
        if not os.path.lexists(output):
            return
        if not output.is_dir():
            raise InputError(f"--output {output}: a file; allowed is a new folder")
        if output.resolve() == robot.file.parent.resolve():
            raise InputError(f"--output {output}: the folder that the robot is read from; allowed is another one")
        if not force and any(output.iterdir()) and not _made_here(marker):
            raise InputError(
                f"--output {output}: exists, and was not made by kincal export; name a new folder, or write beside "
                "what it holds with --force"
            )
        if not force and robot.description.measure.virtual and _measured(marker):
            raise InputError(
                f"--output {output}: holds a robot that was calibrated from measurements, and this one is virtual; "
                "name a new folder, or replace it with --force"
            )


def _made_here(file: Path) -> bool:
    try:
        with open(file, encoding="utf-8") as stream:
            return stream.readline().startswith((f"# {MADE_HERE}", f"/* {MADE_HERE}"))
    except (OSError, ValueError):
        return False


def _measured(file: Path) -> bool:
    """Whether export wrote this file for a robot that was measured."""
    return _made_here(file) and VIRTUAL not in file.read_text(encoding="utf-8", errors="replace")


def check_parent(output: Path) -> None:
    """InputError where `output` can't stand: its folder is missing."""
    if not output.absolute().parent.is_dir():
        raise InputError(f"--output {output}: there is no folder {str(output.parent)!r}; make it first")


@contextmanager
def beside(output: Path) -> Iterator[Path]:
    """A folder beside `output`, from where it is renamed into place; gone at the end, whatever happens."""
    temporary = output.absolute().parent / f".kincal-export-{uuid.uuid4().hex}"
    try:
        with refusing(f"--output {output}"):
            temporary.mkdir()
            yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
