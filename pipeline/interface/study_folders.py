"""The folders of a study: its store, and where its files go."""

from __future__ import annotations

import shutil
from collections.abc import Generator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from kincal.pipeline.interface.arguments import path
from kincal.pipeline.interface.sessions import temporary_folder


@contextmanager
def store_of(store: str | PathLike[str] | None) -> Generator[Path]:
    """The store of a study; None: a temporary one, removed at the end."""
    folder = temporary_folder() if store is None else path("store", store)
    try:
        yield folder
    finally:
        if store is None:
            shutil.rmtree(folder, ignore_errors=True)


def output_of(output: str | PathLike[str] | bool, in_store: Path) -> Path | None:
    """The folder of a study's files, tried before hours of work; None: none are wanted. Raises InputError."""
    from kincal.pipeline.store.files import output_folder

    if output is False:
        return None
    return output_folder(None if output is True else path("output", output), in_store)
