"""Foreign columns of a stream -> t [s], pose, angles [rad], rates [rad/s], accelerations [m/s2], heave [m]."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import UNITS
from kincal.identification.table_files import floats
from kincal.urdf.description import Column, Measure, listed
from kincal.urdf.errors import InputError, quoted

REQUIRED = ("t", "roll", "pitch")
OPTIONAL = ("yaw", *(f"{sensor}_{axis}" for sensor in ("gyro", "acc") for axis in "xyz"), "heave")
ANGLES = ("roll", "pitch", "yaw")


def mapped(names: Sequence[str], measure: Measure, file: Path, by_pose: bool) -> dict[str, Column]:
    """{kincal's name: the file's column and unit} of a stream file with columns `names`.

    by_pose: a `pose` column must say which pose each sample is of. Raises InputError for a missing column.
    """
    needed = (*REQUIRED, "pose") if by_pose else REQUIRED
    columns = {}
    for name in ("t", "pose", "roll", "pitch", *OPTIONAL) if by_pose else (*REQUIRED, *OPTIONAL):
        column = measure.columns.get(name, Column.model_validate({"from": name}))
        if column.source not in names and name in names:  # a canonical stream needs no map
            column = Column.model_validate({"from": name})
        if column.source in names:
            columns[name] = column
        elif name in needed:
            hint = "; a command log (measure.commands) does without" if name == "pose" else ""
            has = listed(names)
            raise InputError(f"{file}: column {quoted(column.source)} is missing from the stream; it has {has}{hint}")
    return columns


def values(raw: pd.DataFrame, columns: dict[str, Column]) -> pd.DataFrame:
    """A stream's rows: NaN for what is no number; t may be ISO 8601."""
    numbers_by_name = {}
    for name, column in columns.items():
        written = pd.Series(raw[column.source])
        read = floats(written)
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are too large, or none
            numbers_by_name[name] = (times(written, read) if name == "t" else read) * UNITS[column.unit]
    return pd.DataFrame(numbers_by_name)


def times(written: pd.Series, values: np.ndarray) -> np.ndarray:
    """(n,) seconds: `values`, or seconds since 1970 where the column is text in ISO 8601 (UTC unless it says else)."""
    if pd.api.types.is_numeric_dtype(written):
        return values
    try:
        text = written.astype(str)
    except UnicodeDecodeError:  # bytes, of Parquet
        return values
    stamps = pd.to_datetime(text, utc=True, errors="coerce", format="ISO8601")
    seconds = (stamps - pd.Timestamp("1970-01-01", tz="UTC")).dt.total_seconds().to_numpy(float)
    return np.where(np.isfinite(values), values, seconds)


def clock(text: str) -> float:
    """[s] a logger's time stamp: ISO 8601 (UTC unless it says else), or seconds, ms, us or ns since 1970; else NaN."""
    try:
        stamp = datetime.fromisoformat(text)
        return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        pass
    try:
        value = float(text)
    except ValueError:
        return np.nan
    for size in (1e17, 1e14, 1e11):
        if abs(value) >= size:
            return value / (size / 1e8)
    return value
