"""A robot's way through the stages, opened: its store, and whoever watches."""

from __future__ import annotations

import shutil
import weakref
from os import PathLike
from pathlib import Path

from kincal.pipeline.interface.arguments import path
from kincal.pipeline.interface.progress import StageObserver, stage_observer
from kincal.pipeline.interface.robots import RobotLike, robot_of
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.ownership import warn_of_others
from kincal.pipeline.store.store import Store
from kincal.urdf.description import nearest
from kincal.urdf.errors import InputError

COMMAND = "kincal in Python"  # what provenance says of results that no command line asked for


def opened(
    robot: RobotLike,
    store: str | PathLike[str] | None = None,
    progress: StageObserver = False,
    command: str = COMMAND,
    force_from: str | None = None,
) -> Run:
    """The robot's way through the stages. Raises InputError.

    store: the folder of cached results; None: a temporary one, removed together with the answer.
    command: what provenance says of where a result came from.
    """
    if force_from is not None and force_from not in all_stages():
        raise InputError(f"--force-from {force_from}: no such stage; {nearest(force_from, all_stages())}")
    loaded = robot_of(robot)
    folder = temporary_folder() if store is None else path("store", store)
    warn_of_others(folder)
    session = Run(loaded, Store(folder), force_from, stage_observer(progress, loaded.description.name), command)
    if store is None:
        weakref.finalize(session, shutil.rmtree, folder, ignore_errors=True)
    return session


def temporary_folder() -> Path:
    """Make a temporary folder; the caller removes it."""
    import tempfile

    return Path(tempfile.mkdtemp(prefix="kincal-"))
