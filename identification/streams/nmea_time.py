"""When an NMEA sentence was: by the logger's stamp, by the sentences' own times, or by a nominal rate."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Protocol

import numpy as np

Values = tuple[float, float, float, float]
Row = tuple[float, ...]
_DAY = 86400.0
_LONGEST = 10.0  # [s] between two ZDA: beyond it samples are not spread over the time between
_MOST = 100_000  # samples that wait for a ZDA


def whole_seconds(stamps: np.ndarray) -> bool:
    """Whether stamps (n,) [s] are whole seconds, and most repeat the one before: sampled faster than stamped."""
    return bool(len(stamps) > 2 and np.all(stamps % 1 == 0) and 2 * np.sum(np.diff(stamps) == 0) > len(stamps))


class Clock(Protocol):
    untimed: int  # samples that no time could be given

    def sample(self, stamp: float, utc: float, values: Values) -> list[Row]:
        """Samples that are complete now; utc [s] of the day, NaN where the sentence does not say it."""
        ...

    def zda(self, message: Any) -> list[Row]: ...

    def missed(self) -> None:
        """A sentence of the kind that samples come from failed its checksum."""
        ...

    def rest(self) -> list[Row]: ...


@dataclass
class FromStamps:
    untimed: int = 0

    def sample(self, stamp: float, utc: float, values: Values) -> list[Row]:
        return [(stamp, *values)]

    def zda(self, message: Any) -> list[Row]:
        return []

    def missed(self) -> None: ...

    def rest(self) -> list[Row]:
        return []


@dataclass
class Nominal:
    """Samples at a fixed rate [Hz]; a lost one keeps its place."""

    rate: float
    untimed: int = 0
    count: int = 0

    def sample(self, stamp: float, utc: float, values: Values) -> list[Row]:
        self.count += 1
        return [((self.count - 1) / self.rate, *values)]

    def zda(self, message: Any) -> list[Row]:
        return []

    def missed(self) -> None:
        self.count += 1

    def rest(self) -> list[Row]:
        return []


@dataclass
class FromSentences:
    """PASHR says its time. Others are spread evenly from the ZDA before them to the next."""

    untimed: int = 0
    now: float = np.nan  # [s] since 1970, or since midnight where nothing gives the date: the last time that was said
    last: float = np.nan  # the last ZDA [s]
    spacing: float = np.nan  # [s] between samples
    waiting: list[Values] = field(default_factory=list)

    def sample(self, stamp: float, utc: float, values: Values) -> list[Row]:
        if np.isfinite(utc):
            days = 0.0 if np.isnan(self.now) else round((self.now - utc) / _DAY)  # the one nearest to what came before
            self.now = _DAY * days + utc
            return [(self.now, *values)]
        if np.isnan(self.last):
            self.untimed += 1
            return []
        self.waiting.append(values)
        return self.rest() if len(self.waiting) >= _MOST else []

    def zda(self, message: Any) -> list[Row]:
        try:
            midnight = datetime(int(message.year), int(message.month), int(message.day), tzinfo=UTC).timestamp()
            t = message.time
            seconds = t.hour * 3600 + t.minute * 60 + t.second + 1e-6 * t.microsecond
        except (AttributeError, TypeError, ValueError, OverflowError):
            return []
        return self._since(midnight + seconds)

    def _since(self, now: float) -> list[Row]:
        """The samples that wait, spread over the time to `now` [s], from which the next ones count."""
        if self.waiting and 0 < now - self.last <= _LONGEST:
            self.spacing = (now - self.last) / len(self.waiting)
        rows = self.rest()
        self.last = self.now = now
        return rows

    def missed(self) -> None: ...

    def rest(self) -> list[Row]:
        """The samples that wait, at the last spacing."""
        spacing = 1.0 if np.isnan(self.spacing) else self.spacing
        rows = [(self.last + k * spacing, *values) for k, values in enumerate(self.waiting)]
        self.last, self.waiting = self.last + spacing * len(rows), []
        return rows


@dataclass
class FromSeconds(FromSentences):
    """Stamps in whole seconds, of a sensor that is faster: samples are spread evenly from one second to the next."""

    def sample(self, stamp: float, utc: float, values: Values) -> list[Row]:
        if np.isnan(stamp):
            return [(np.nan, *values)]
        rows = self._since(stamp) if stamp != self.now else []
        self.waiting.append(values)
        return rows + (self.rest() if len(self.waiting) >= _MOST else [])

    def zda(self, message: Any) -> list[Row]:
        return []
