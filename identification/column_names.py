"""The columns of a table that somebody brought: which of them are used, which nearly are, and which are not."""

from __future__ import annotations

import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path

from kincal.urdf.description import Column, listed
from kincal.urdf.errors import TableError

_NEAR = 0.84  # similarity of names, 0 .. 1: the other one is meant
_SHORTEST = 5  # letters of names that may be meant: shorter ones are near to many


def matched(present: Sequence[str], wanted: Iterable[str]) -> dict[str, str]:
    """{wanted name: the column that has it}: by its exact name, else by the name without blanks and capitals.

    Only where that is unambiguous: of two joints, or two columns, that differ in case alone, each stays itself.
    """
    exact, by_fold, same = set(present), defaultdict(list), defaultdict(list)
    names = list(dict.fromkeys(wanted))
    for column in present:
        by_fold[_folded(column)].append(column)
    for name in names:
        same[_folded(name)].append(name)
    found = {}
    for name in names:
        near = by_fold[_folded(name)]
        if name in exact:
            found[name] = name
        elif len(near) == 1 and len(same[_folded(name)]) == 1:
            found[name] = near[0]
    return found


def unused(present: Sequence[str], used: Iterable[str]) -> tuple[str, ...]:
    """The columns that nothing reads, in the table's order."""
    read = set(used)
    return tuple(name for name in present if name not in read)


def unused_note(columns: Sequence[str]) -> str:
    """One sentence that names them; empty where there are none."""
    if not columns:
        return ""
    return f"column{'s' * (len(columns) > 1)} {listed(columns)} {'are' if len(columns) > 1 else 'is'} not used"


def misspelt(columns: Sequence[str], missing: Iterable[str]) -> tuple[str, str] | None:
    """The first unused column that nearly has the name of a missing one, and that name."""
    names = {_folded(name): name for name in missing if len(name) >= _SHORTEST}
    for column in columns:
        near = get_close_matches(_folded(column), names, n=1, cutoff=_NEAR) if len(column) >= _SHORTEST else []
        if near:
            return column, names[near[0]]
    return None


def check_units(sources: Mapping[str, Column], groups: Iterable[Sequence[str]], file: Path | str) -> None:
    """Refuse a group of columns of which one has a unit other than kincal's, and another none. Raises TableError."""
    for group in groups:
        columns = {name: sources[name] for name in group if name in sources}
        plain = [name for name, c in columns.items() if c.unit == "1" and "unit" not in c.model_fields_set]
        other = next((name for name, c in columns.items() if c.unit not in ("1", "m", "rad")), None)
        if plain and other is not None:
            message = f"column {other} has the unit {columns[other].unit!r}, but {plain[0]} has no unit"
            raise TableError(f"{file}: {message}: set that of each in measure.columns", plain[0])


def _folded(name: str) -> str:
    return unicodedata.normalize("NFKC", name).strip().casefold()
