"""A mistake that a table of measurements may have: its cause in words, and the measurements without it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from kincal.identification.channels.channel import Channel
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.urdf.description import listed

SOME_POSES, CONTRADICTION = 1, 2  # how general a mistake is, above 0


@dataclass(frozen=True)
class Mistake:
    """Tried where measurements contradict the drawing: named if the residuals are much smaller without it."""

    cause: str
    undone: Callable[[Measurements], Measurements]
    alike: str = ""  # words for several of its kind, where a symmetry makes them one
    wrong: tuple[int, ...] = ()  # the poses that it says are wrong; empty: all are, or none
    lasting: bool = False  # the fit goes on, and a finding tells of it
    foreseen: float = 0.0  # the misfit without it, where first derivatives foresee it
    rows: int = 0  # how many poses it leaves out
    general: int = 0  # of those that explain as much, the least general say most


Kind = Callable[[ErrorModel, Measurements], Iterator[Mistake]]  # all of one kind that these measurements may have


def of_values(cause: str, channel: Channel, change: Callable[[np.ndarray], np.ndarray]) -> Mistake:
    """A mistake in the values of one channel."""
    return Mistake(cause, lambda m: m.replaced(**{channel.name: change(m.values[channel.name])}))


def numbered(poses: np.ndarray) -> str:
    """Poses by their numbers, in words."""
    return f"pose{'s' * (len(poses) > 1)} {listed(poses)}"


def of_rows(cause: str, measured: Measurements, wrong: np.ndarray, general: int = 0) -> Mistake:
    """A mistake in some rows alone, `wrong` (n,) bool."""
    poses = measured.pose[wrong]
    numbers = tuple(int(n) for n in poses)
    return Mistake(cause, lambda m: m[~np.isin(m.pose, poses)], wrong=numbers, rows=len(numbers), general=general)
