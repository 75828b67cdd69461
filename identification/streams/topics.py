"""Rows of several topics on one axis of time, blank where a topic has no value: a stream's or a command log's.

A row of one topic says nothing of the others. It is no fault of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from kincal.identification.streams.health import Tally

_OLDEST = 0.5  # [s] an older value of another row is none of now
_WAITING = 1000  # rows without an attitude that may hold a channel of the next one's


@dataclass
class Topics:
    """A stream's rows in chunks -> those that hold roll and pitch. NaN is a blank cell."""

    tally: Tally
    separate: bool | None = None  # whether roll and pitch stand in rows of their own; None: the first chunk tells
    joined: str = "pitch"  # then: the rarer of both, whose rows are kept
    waiting: pd.DataFrame | None = None

    def feed(self, chunk: pd.DataFrame) -> pd.DataFrame:
        """The rows that are complete now, with those values of other channels that came since the row before."""
        if self.waiting is not None:
            chunk = pd.concat([self.waiting, chunk], ignore_index=True)
        rows = np.flatnonzero(self._kept(chunk))
        end = int(rows[-1]) + 1 if len(rows) else 0
        begin = max(end, len(chunk) - _WAITING)
        self.tally.other += begin - len(rows)
        self.waiting = chunk.iloc[begin:] if begin < len(chunk) else None
        return chunk if len(rows) == len(chunk) else self._filled(chunk, rows)

    def rest(self) -> None:
        """After the last chunk: rows that wait are of no use; a note where there were any."""
        tally = self.tally
        tally.other += 0 if self.waiting is None else len(self.waiting)
        if self.separate:
            other = "roll" if self.joined == "pitch" else "pitch"
            tally.notes += (f"roll and pitch are in separate rows; each {self.joined} has the last {other} before it",)
        elif tally.other:
            tally.notes += (f"{tally.other} of {tally.read} rows have blank cells in roll and pitch; they are skipped",)

    def _kept(self, chunk: pd.DataFrame) -> np.ndarray:
        has = {name: chunk[name].notna().to_numpy() for name in ("roll", "pitch")}
        either = has["roll"] | has["pitch"]
        if self.separate is None and either.any():
            self.separate = are_separate(np.column_stack(list(has.values())))
            self.joined = min(has, key=lambda name: int(has[name].sum()))
        return has[self.joined] if self.separate else either

    def _filled(self, chunk: pd.DataFrame, rows: np.ndarray) -> pd.DataFrame:
        t, place, before = chunk["t"].to_numpy(float), np.arange(len(chunk)), np.concatenate([[-1], rows[:-1]])
        filled = chunk.iloc[rows].reset_index(drop=True)
        for name in [c for c in chunk if c not in ("t", "pose")]:
            values = chunk[name].to_numpy(float)
            last = np.maximum.accumulate(np.where(np.isnan(values), -1, place))[rows]
            with np.errstate(over="ignore", invalid="ignore"):  # of times that are none
                fresh = (last > before) & (np.abs(t[rows] - t[last]) <= _OLDEST)
            filled[name] = np.where(fresh, values[last], np.nan)
        return filled


def are_separate(has: np.ndarray) -> bool:
    """Whether columns are of different topics: of the rarest one's values, at most half stand in a row with all others.

    has: (n, k) whether a cell is not blank.
    """
    return bool(2 * np.sum(has.all(axis=1)) <= np.min(has.sum(axis=0)))
