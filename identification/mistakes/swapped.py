"""Joint columns that are swapped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake


def swapped_joints(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Every pair."""
    names = model.chain.actuated_names
    for i, j in combinations(range(len(names)), 2):

        def undone(m: Measurements, i: int = i, j: int = j) -> Measurements:
            readings = m.readings.copy()
            readings[:, [i, j]] = m.readings[:, [j, i]]
            return replace(m, readings=readings)

        yield Mistake(f"the columns {names[i]} and {names[j]} are swapped", undone)
