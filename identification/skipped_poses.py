"""Poses that `measure.skip` leaves out, by their numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from kincal.urdf.description import listed
from kincal.urdf.errors import TableError


def kept(poses: np.ndarray, skip: Sequence[int], file: Path | str, others: Iterable[int] = ()) -> np.ndarray:
    """(n,) which poses stay. Raises TableError for a number that no pose has, and where none stays.

    others: poses that are known, but left out already.
    """
    known = set(poses[np.isfinite(poses)].tolist()) | set(others)
    unknown = [number for number in skip if number not in known]
    if unknown:
        raise TableError(f"{file}: measure.skip: no pose {listed(unknown)}; allowed are {spans(known)}", "pose")
    stay = ~np.isin(poses, list(skip))
    if len(poses) and not stay.any():
        raise TableError(f"{file}: measure.skip leaves out all {len(poses)} poses; at least one is needed", "pose")
    return stay


def skip_note(skip: Iterable[int], file: Path | str) -> str:
    """One sentence that names them."""
    numbers = sorted(set(skip))
    return f"{file}: pose{'s' * (len(numbers) > 1)} {listed(numbers)}: left out by measure.skip"


def spans(numbers: Iterable[float]) -> str:
    """Whole numbers as ranges: 0 to 4, 7, 9 to 12."""
    ordered = np.unique([int(number) for number in numbers])
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return listed(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs if len(run))
