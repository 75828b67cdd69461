"""The command log: what the actuators were told, and when. Targets that are held become poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import numbers
from kincal.identification.streams.columns import sources, times
from kincal.identification.streams.topics import are_separate
from kincal.identification.table_files import load
from kincal.identification.time_stamps import ALLOWED, FARTHEST, Midnights
from kincal.urdf.description import Column, Measure, listed
from kincal.urdf.errors import InputError, quoted

_TRAJECTORY = 1.0  # [s] a single row that holds for less is a point of a trajectory, no target


@dataclass(frozen=True)
class Holds:
    """k targets that were held, in order of time, on the command log's clock.

    begin, end: (k,) [s], the last end infinite; joints: (k, n) readings; pose: (k,) their numbers.
    """

    begin: np.ndarray
    end: np.ndarray
    joints: np.ndarray
    pose: np.ndarray

    def __len__(self) -> int:
        return len(self.begin)


def read_commands(file: Path, joints: Sequence[str], measure: Measure) -> Holds:
    """A command log: `t` (see time_stamps), a column a joint, and `pose` where targets have numbers.

    A row holds from its time to the next row's: targets alone, or a controller's set points many times a second. Rows
    that are blank in all joints command nothing.
    Raises InputError that names the column, the row and the value.
    """
    raw = load(file, measure, joints)
    maps = sources([str(name) for name in raw.columns], ("t", *joints, "pose"), measure)
    raw = _commanding(raw, [maps[name].source for name in joints if name in maps])
    rows, columns = raw.index.to_numpy() + 1, {}
    for name in ("t", *joints, "pose"):
        if name == "t" and name in maps:
            columns[name] = _times(raw, maps, file)
        elif name in maps:
            columns[name] = numbers(raw[maps[name].source].tolist(), maps[name], file, rows - 1)
        elif name != "pose":
            source, has = measure.columns[name].source if name in measure.columns else name, listed(raw.columns)
            raise InputError(f"{file}: column {quoted(source)} ({name}) is missing from the command log; it has {has}")
    t, pose = columns.pop("t"), columns.pop("pose", None)
    _check(t, pose, rows, file)
    return _holds(t, np.column_stack(list(columns.values())), pose)


def _check(t: np.ndarray, pose: np.ndarray | None, rows: np.ndarray, file: Path) -> None:
    """Raises InputError for times (n,) [s] that don't increase, and poses (n,) that are no numbers of poses."""
    if len(t) < 2:
        raise InputError(f"{file}: {len(t)} rows; a command log needs at least two")
    backwards = np.flatnonzero(np.diff(t) <= 0)
    if len(backwards):
        k = backwards[0] + 1
        raise InputError(
            f"{file}: column 't', row {rows[k]}: time must increase; found {t[k]:.6f} after {t[k - 1]:.6f} s"
        )
    if pose is not None and (pose != np.round(pose)).any():
        k = int(np.argmax(pose != np.round(pose)))
        raise InputError(f"{file}: column 'pose', row {rows[k]}: found {pose[k]:g}; allowed are whole numbers")


def _commanding(raw: pd.DataFrame, joints: list[str]) -> pd.DataFrame:
    """The rows that command something; where joints have rows of their own, each holds its last value."""
    has = raw[joints].notna().to_numpy(bool)
    if not has.any() or has.all():
        return raw
    raw = raw.iloc[np.flatnonzero(has.any(axis=1))]
    if are_separate(has):
        raw = raw.assign(**{name: raw[name].ffill() for name in joints}).dropna(subset=joints)
    return raw


def _times(raw: pd.DataFrame, columns: dict[str, Column], file: Path) -> np.ndarray:
    """(n,) [s]. Raises InputError that names the row."""
    seconds, source = times(raw, columns), columns["t"].source
    bad = np.flatnonzero(~(np.abs(seconds) < FARTHEST))
    if len(bad):
        value, row = str(raw[source].iloc[bad[0]])[:80], raw.index[bad[0]] + 1
        raise InputError(f"{file}: column {quoted(source)}, row {row}: found {quoted(value)}; allowed are {ALLOWED}")
    text = not pd.api.types.is_numeric_dtype(raw[source])
    return Midnights().run_on(seconds) if text else seconds


def _holds(t: np.ndarray, joints: np.ndarray, pose: np.ndarray | None) -> Holds:
    new = (np.diff(joints, axis=0) != 0).any(axis=1)
    if pose is not None:
        new |= np.diff(pose) != 0
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    begin, end = t[first], np.append(t[first[1:]], np.inf)
    rows = np.diff(np.append(first, len(t)))
    held = (rows > 1) | (end - begin >= _TRAJECTORY)
    held[-1] = held[-1] and (rows[-1] > 1 or len(held) < 2 or held[-2] or end[-2] - begin[-2] >= _TRAJECTORY)
    first = first[held]
    number = np.arange(len(first)) if pose is None else pose[first]
    return Holds(begin[held], end[held], joints[first], number.astype(np.int64))
