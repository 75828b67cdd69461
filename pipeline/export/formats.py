"""The formats of `kincal export`. A new one is a module with a function `export`, and a line here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from kincal.pipeline.run.runner import Run
from kincal.urdf.description import nearest
from kincal.urdf.errors import InputError, UnknownNameError


class Export(Protocol):
    """What was written, and how well it agrees with the identified model."""

    @property
    def path(self) -> Path | None:
        """None: a document that was not written."""
        ...

    @property
    def document(self) -> Mapping[str, Any] | None: ...

    @property
    def note(self) -> str:
        """What a user should know; empty: nothing."""
        ...

    @property
    def lines(self) -> tuple[str, ...]:
        """For people, a sentence each."""
        ...


@dataclass(frozen=True)
class Format:
    """A format, and the module whose `export(session, output, force, method)` writes it."""

    module: str
    help: str
    methods: tuple[str, ...] = ()  # of which one is exported, the first by default; empty: the geometry is


FORMATS = {
    "urdf": Format("folder", "a folder with robot.urdf, robot.toml and parameters.csv"),
    "json": Format("document", "one document"),
    "c": Format(
        "c_code",
        "a folder with the compensator for a controller, one C file with its header and a test program",
        methods=("hybrid", "geometric"),
    ),
}


def export(session: Run, format: str, output: Path | None, force: bool, method: str | None) -> Export:
    """Write a calibrated robot in one of the formats. Raises InputError and CalibrationError."""
    if format not in FORMATS:
        raise UnknownNameError(f"--format {format}: no such format; {nearest(format, FORMATS)}", format, FORMATS)
    chosen = FORMATS[format]
    if method is not None and not chosen.methods:
        allowed = ", ".join(f"--format {name}" for name, other in FORMATS.items() if other.methods)
        raise InputError(f"--method {method}: --format {format} has none; allowed with {allowed}")
    if method is not None and method not in chosen.methods:
        raise InputError(f"--method {method}: --format {format} has code for {' and '.join(sorted(chosen.methods))}")
    used = method or next(iter(chosen.methods), None)
    return import_module(f"kincal.pipeline.export.{chosen.module}").export(session, output, force, used)
