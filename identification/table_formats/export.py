"""What exports have in common: frames in rows, and rigid bodies and markers in groups of columns."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from kincal.identification.channels.orientation import QUATERNION
from kincal.urdf.description import Measure, listed
from kincal.urdf.errors import InputError, quoted

POSITION = ("x", "y", "z")
HEAD = 60  # lines that are looked at
_FARTHEST = 1e6  # [m] a position beyond is none


@dataclass(frozen=True)
class Source:
    """A file, and what is known of it before it is read."""

    file: Path
    lines: tuple[str, ...]  # its first ones
    encoding: str


class Format(Protocol):
    """A kind of export."""

    name: str  # for messages

    def recognises(self, lines: Sequence[str]) -> bool:
        """Whether a file that begins with these lines is one."""
        ...

    def read(self, source: Source, measure: Measure) -> pd.DataFrame:
        """One row a frame: frame, t [s], x, y, z [m] and, of a rigid body, qx, qy, qz, qw; NaN in gaps.

        Raises InputError. `attrs["notes"]` says what was read.
        """
        ...


@dataclass(frozen=True)
class Target:
    """A rigid body or a marker: where its numbers are."""

    name: str
    position: tuple[int, ...]  # columns of x, y, z
    rotation: tuple[int, ...] = ()  # columns; none: a marker


def chosen(targets: Sequence[Target], body: str | None, file: Path) -> Target:
    """The one that `measure.body` names, else the only rigid body, else the only marker. Raises InputError."""
    bodies = [target for target in targets if target.rotation]
    names = [target.name for target in bodies or targets]
    if body is None:
        candidates = bodies or list(targets)
        problem = f"it has {len(names)} {'rigid bodies' if bodies else 'markers'}: set measure.body"
    else:
        candidates = [t for t in targets if t.name == body]
        candidates = [t for t in candidates if t.rotation] or candidates
        problem = f"measure.body: {len(candidates) or 'no'} rigid body or marker has the name {quoted(body)}"
        names = [*names, *(target.name for target in targets if not target.rotation)] if bodies else names
    if len(candidates) == 1:
        return candidates[0]
    raise InputError(f"{file}: {problem}; allowed are {listed(dict.fromkeys(names))}")


def cells(source: Source, begin: int, separator: str, columns: Iterable[int]) -> pd.DataFrame:
    """The numbers of some columns from a line on; NaN for blanks and for what is no number."""
    wanted = sorted(set(columns))
    width = source.lines[begin].count(separator) + 1 if begin < len(source.lines) else 0
    if not width:
        return pd.DataFrame(columns=wanted, dtype=float)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        table = pd.read_csv(
            source.file,
            sep=separator,
            skiprows=begin,
            header=None,
            names=list(range(width)),
            usecols=[k for k in wanted if k < width],
            index_col=False,
            encoding=source.encoding,
            dtype=str,
        )
    return table.apply(pd.to_numeric, errors="coerce").reindex(columns=wanted).astype(float)


def frames(frame: np.ndarray, t: np.ndarray, position: np.ndarray, rotation: np.ndarray | None) -> pd.DataFrame:
    """The table of a body. position: (n, 3) [m], NaN in gaps; rotation: (n, 4) quaternions, NaN in gaps."""
    position = np.where(np.abs(position) < _FARTHEST, position, np.nan)
    columns = {"frame": frame, "t": t} | dict(zip(POSITION, position.T, strict=True))
    if rotation is not None:
        columns |= dict(zip(QUATERNION, rotation.T, strict=True))
    return pd.DataFrame(columns)


def quaternions(values: np.ndarray, convert: Callable[[np.ndarray], Rotation]) -> np.ndarray:
    """(n, 4) by a function of the rows (m, k) that have numbers -> Rotation; NaN elsewhere."""
    result = np.full((len(values), 4), np.nan)
    known = np.isfinite(values).all(axis=1)
    if known.any():
        result[known] = convert(values[known]).as_quat(canonical=True)
    return result


def described(table: pd.DataFrame, source: Source, form: str, target: Target) -> pd.DataFrame:
    """The table with a note that says what it is."""
    gaps = int(table[POSITION[0]].isna().sum())
    kind = "rigid body" if target.rotation else "marker"
    without = f", {gaps} of them without it" if gaps else ""
    note = f"{source.file}: a {form} export: read {kind} {quoted(target.name)} in {len(table)} frames{without}"
    table.attrs.update(notes=(note,), export=form)
    return table
