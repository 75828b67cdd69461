"""Time as loggers write it: numbers, ISO 8601, day-first dates, the time of day; date and time in two columns.

Numbers count ms, us or ns since 1970 where that is a time in the years 1990 to 2100, and their steps are no longer than
those of a log.
A time without a zone is UTC: the offset of two clocks is estimated in any case.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import pandas as pd

ALLOWED = (
    "seconds, or ms, us or ns since 1970; ISO 8601 (2026-01-31T09:33:20.1Z); 31.01.2026 09:33:20.1 (day first); "
    "09:33:20.1 (time of day)"
)
DAY = 86400.0
FARTHEST = 1e12  # [s] beyond it a number is no time
_EPOCH = pd.Timestamp("1970-01-01", tz="UTC")
_SCALES = (1e-3, 1e-6, 1e-9)  # [s] units that count since 1970
_YEARS = (6.3e8, 4.1e9)  # [s] since 1970: 1990 to 2100
SAMPLED, _STEP = 5.0, 600.0  # [s] longest steps of a log, and of commands
_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2}(?:[.,]\d*)?))?\s*(?P<half>[AaPp][Mm])?"
_DATE = r"(?:(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})|(?P<y>\d{4})[/.](?P<m>\d{1,2})[/.](?P<d>\d{1,2}))"
_WRITTEN = re.compile(rf"\s*(?:{_DATE}[\sT,;]+)?{_CLOCK}\s*", re.ASCII)


def seconds_of(text: str) -> float:
    """[s] one time stamp; NaN for what is none."""
    try:
        number = float(text)
        return number * scale_of(np.array([number]))
    except (ValueError, OverflowError):
        pass
    try:
        stamp = datetime.fromisoformat(text)
        return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return _written(text)


def in_seconds(written: pd.Series, scale: float | None = None) -> np.ndarray:
    """(n,) [s] time stamps; since 1970, or since midnight where no date is given; NaN for what is none.

    scale: [s] what numbers count; None: as they tell.
    """
    if pd.api.types.is_numeric_dtype(written):
        return _scaled(written.to_numpy(float, na_value=np.nan), scale)
    if pd.api.types.is_datetime64_any_dtype(written):
        return _since(pd.to_datetime(written, utc=True))
    try:
        text = written.astype(str)
    except UnicodeDecodeError:  # bytes, of Parquet
        return np.full(len(written), np.nan)
    seconds = _scaled(_numbers(written), scale)
    for read in (_iso, _others):
        left = np.isnan(seconds)
        if left.any():
            seconds[left] = read(text[left])
    return seconds


def scale_of(numbers: np.ndarray, longest: float = _STEP) -> float:
    """[s] the unit that numbers (n,) count since 1970, in their order; 1 where their size tells none.

    longest: [s] the median step may be so long; a longer one is that of another unit.
    """
    known = numbers[np.isfinite(numbers)]
    if not len(known):
        return 1.0
    with np.errstate(over="ignore"):
        middle, steps = float(np.median(known)), np.abs(np.diff(known))
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    return next((s for s in _SCALES if _YEARS[0] <= middle * s <= _YEARS[1] and step * s <= longest), 1.0)


def together(date: pd.Series, time: pd.Series) -> pd.Series:
    """Texts of date and time, from two columns."""
    return date.astype(str).str.strip() + " " + time.astype(str).str.strip()


@dataclass
class Midnights:
    """Times of day -> times that run on: a day is added where they start again."""

    days: int = 0
    last: float = np.nan

    def run_on(self, seconds: np.ndarray) -> np.ndarray:
        """(n,) the next times [s]. Times since 1970 stay as they are."""
        known = np.flatnonzero((seconds >= 0) & (seconds < DAY))
        if not len(known):
            return seconds
        steps = np.diff(seconds[known], prepend=seconds[known[0]] if np.isnan(self.last) else self.last)
        days = self.days + np.cumsum((steps < -DAY / 2).astype(int) - (steps > DAY / 2))
        self.days, self.last = int(days[-1]), float(seconds[known[-1]])
        result = seconds.copy()
        result[known] += DAY * days
        return result


def _scaled(numbers: np.ndarray, scale: float | None) -> np.ndarray:
    return numbers * (scale_of(numbers) if scale is None else scale)


def _numbers(written: pd.Series) -> np.ndarray:
    try:
        return np.array(pd.to_numeric(written, errors="coerce"), dtype=float)
    except OverflowError:  # a whole number of hundreds of digits
        return np.full(len(written), np.nan)


def _iso(text: pd.Series) -> np.ndarray:
    return _since(
        pd.to_datetime(text.str.strip().str.replace(",", ".", regex=False), utc=True, errors="coerce", format="ISO8601")
    )


def _since(stamps: pd.Series) -> np.ndarray:
    return (stamps - _EPOCH).dt.total_seconds().to_numpy(float)


def _others(text: pd.Series) -> np.ndarray:
    """Day-first dates, dates with slashes that begin with the year, and times of day."""
    return np.array([_written(str(cell)) for cell in text], dtype=float)


def _written(cell: str) -> float:
    match = _WRITTEN.fullmatch(cell)
    if match is None:
        return np.nan
    part = match.groupdict(default="")
    hour, minute, second = int(part["hour"]), int(part["minute"]), float((part["second"] or "0").replace(",", "."))
    if part["half"]:
        if not 1 <= hour <= 12:
            return np.nan
        hour = hour % 12 + 12 * (part["half"].lower() == "pm")
    if hour > 23 or minute > 59 or second >= 61:
        return np.nan
    of_day = 3600.0 * hour + 60.0 * minute + second
    year, month, day = (part[a] or part[b] for a, b in (("year", "y"), ("month", "m"), ("day", "d")))
    if not year:
        return of_day
    try:
        return float(np.datetime64(f"{year}-{month:0>2}-{day:0>2}", "s").astype(float)) + of_day
    except ValueError:
        return np.nan
