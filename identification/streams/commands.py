"""The command log: what the actuators were told, and when. Targets that are held become poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import numbers
from kincal.identification.streams.columns import times
from kincal.identification.table_files import floats, load
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
    """A command log: `t` [s or ISO 8601], a column a joint, and `pose` where targets have numbers.

    A row holds from its time to the next row's: targets alone, or a controller's set points many times a second.
    Raises InputError that names the column, the row and the value.
    """
    raw = load(file, measure, joints)
    columns = {}
    for name in ("t", *joints, "pose"):
        column = measure.columns.get(name, Column.model_validate({"from": name}))
        if column.source not in raw.columns and name in raw.columns:
            column = Column.model_validate({"from": name})
        if column.source in raw.columns:
            values = pd.Series(raw[column.source])
            if name == "t" and not pd.api.types.is_numeric_dtype(values):
                seconds = times(values, floats(values))
                values = values.where(~np.isfinite(seconds), pd.Series(seconds, dtype=object, index=values.index))
            columns[name] = numbers(values.tolist(), column, file)
        elif name != "pose":
            has = listed(raw.columns)
            missing = f"column {quoted(column.source)} ({name}) is missing from the command log"
            raise InputError(f"{file}: {missing}; it has {has}")
    t = columns.pop("t")
    if len(t) < 2:
        raise InputError(f"{file}: {len(t)} rows; a command log needs at least two")
    backwards = np.flatnonzero(np.diff(t) <= 0)
    if len(backwards):
        k = backwards[0]
        raise InputError(
            f"{file}: column 't', row {k + 2}: time must increase; found {t[k + 1]:.6f} after {t[k]:.6f} s"
        )
    pose = columns.pop("pose", None)
    if pose is not None and (pose != np.round(pose)).any():
        row = int(np.argmax(pose != np.round(pose)))
        raise InputError(f"{file}: column 'pose', row {row + 1}: found {pose[row]:g}; allowed are whole numbers")
    return _holds(t, np.column_stack(list(columns.values())), pose)


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
