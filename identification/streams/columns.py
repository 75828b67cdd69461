"""Foreign columns of a stream -> t [s], pose, angles [rad], rates [rad/s], accelerations [m/s2], heave [m]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.column_names import matched
from kincal.identification.measurement_table import UNITS
from kincal.identification.table_files import floats
from kincal.identification.time_stamps import ALLOWED, SAMPLED, Midnights, in_seconds, scale_of, together
from kincal.urdf.description import Column, Measure, listed
from kincal.urdf.errors import InputError, quoted

REQUIRED = ("t", "roll", "pitch")
OPTIONAL = ("yaw", *(f"{sensor}_{axis}" for sensor in ("gyro", "acc") for axis in "xyz"), "heave")
ANGLES = ("roll", "pitch", "yaw")
DATE = "date"  # a column that t, a time of day, may have beside it
_CLOCK = "time"  # t's name beside a date


def sources(names: Sequence[str], wanted: Sequence[str], measure: Measure) -> dict[str, Column]:
    """{kincal's name: the file's column and unit}, of the wanted columns that a file with columns `names` has.

    Where there is no t, a date and a time in two columns stand for it.
    """
    maps = {name: measure.columns.get(name, Column.model_validate({"from": name})) for name in (*wanted, DATE, _CLOCK)}
    exact = matched(names, [column.source for column in maps.values()])
    plain = matched(names, maps)  # a canonical stream needs no map
    columns: dict[str, Column] = {}
    for name, column in maps.items():
        if column.source in exact:
            columns[name] = column.model_copy(update={"source": exact[column.source]})
        elif name in plain:
            columns[name] = Column.model_validate({"from": plain[name]})
    date, clock = columns.pop(DATE, None), columns.pop(_CLOCK, None)
    if "t" not in columns and date is not None and clock is not None:
        columns["t"] = clock
    if date is not None and ("t" in measure.columns or columns.get("t") is clock):
        columns[DATE] = date
    return columns


def mapped(names: Sequence[str], measure: Measure, file: Path, by_pose: bool) -> dict[str, Column]:
    """{kincal's name: the file's column and unit} of a stream file with columns `names`.

    by_pose: a `pose` column must say which pose each sample is of. Raises InputError for a missing column.
    """
    needed = (*REQUIRED, "pose") if by_pose else REQUIRED
    columns = sources(names, ("t", "pose", "roll", "pitch", *OPTIONAL) if by_pose else (*REQUIRED, *OPTIONAL), measure)
    missing = next((name for name in needed if name not in columns), None)
    if missing is not None:
        source = measure.columns[missing].source if missing in measure.columns else missing
        hint = "; a command log (measure.commands) does without" if missing == "pose" else ""
        raise InputError(f"{file}: column {quoted(source)} is missing from the stream; it has {listed(names)}{hint}")
    return columns


def times(raw: pd.DataFrame, columns: dict[str, Column], scale: float | None = None) -> np.ndarray:
    """(n,) [s] the times of a file's rows: NaN for what is none.

    scale: [s] what numbers count; None: as the column map says, else as they tell.
    """
    written, unit = pd.Series(raw[columns["t"].source]), columns["t"].unit
    if unit != "1":
        with np.errstate(over="ignore", invalid="ignore"):
            return floats(written) * UNITS[unit]
    if DATE in columns:
        return in_seconds(together(pd.Series(raw[columns[DATE].source]), written))
    return in_seconds(written, scale)


@dataclass
class Rows:
    """A stream's rows in chunks -> numbers; NaN for blank cells, infinity for what else is no number."""

    file: Path
    columns: dict[str, Column]
    midnights: Midnights = field(default_factory=Midnights)
    timed: bool = False  # whether any row had a time
    scale: float | None = None  # [s] what numbers of time count, as the first chunk tells

    def values(self, raw: pd.DataFrame) -> pd.DataFrame:
        numbers = {}
        for name, column in self.columns.items():
            if name == "t":
                numbers[name] = self._times(raw)
            elif name != DATE:
                written = pd.Series(raw[column.source])
                read = floats(written)
                read[np.isnan(read) & written.notna().to_numpy()] = np.inf
                with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are too large, or none
                    numbers[name] = read * UNITS[column.unit]
        return pd.DataFrame(numbers)

    def _times(self, raw: pd.DataFrame) -> np.ndarray:
        written = pd.Series(raw[self.columns["t"].source])
        if self.scale is None and np.isfinite(numbers := floats(written)).any():
            self.scale = scale_of(numbers, SAMPLED)
        seconds = times(raw, self.columns, self.scale)
        self.timed = self.timed or bool(np.isfinite(seconds).any())
        if pd.api.types.is_numeric_dtype(written):
            return seconds
        if not self.timed and len(written):
            raise InputError(
                f"{self.file}: column {quoted(self.columns['t'].source)}: found {quoted(str(written.iloc[0]))}; "
                f"allowed are {ALLOWED}"
            )
        return self.midnights.run_on(seconds)
