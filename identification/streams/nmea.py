"""NMEA 0183 logs: $PSXN,23; $PASHR; $PRDID; $--XDR with PITCH and ROLL; $--HDT; checked and read by pynmeagps.

Signs, as the makers' manuals have them (Kongsberg Seapath, Applanix POS MV, Oxford/Trimble): roll is positive port up,
as kincal's; pitch is positive bow up, kincal's bow down; heading is clockwise from north, yaw = -heading,
counter-clockwise about z up; Seapath's heave is positive down, kincal's up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd

from kincal.identification.streams.health import Tally
from kincal.identification.streams.nmea_lines import TagTimes, parsed_line
from kincal.identification.streams.nmea_time import (
    Clock,
    FromSeconds,
    FromSentences,
    FromStamps,
    Nominal,
    whole_seconds,
)
from kincal.urdf.description import Log
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.input_files import unreadable
from kincal.urdf.rigid_motion import wrap

ATTITUDE = ("PSXN", "PASHR", "PRDID", "XDR")
_ROWS = 20_000  # a chunk
_LONGEST = 4096  # bytes of a line
_HEAD = 200  # lines that tell whether a logger stamped them


@dataclass(frozen=True)
class Attitude:
    """What one sentence says, in its own units and signs [deg, m]."""

    kind: str
    roll: float
    pitch: float
    heading: float = np.nan
    heave_down: float = np.nan
    utc: float = np.nan  # [s] of the day


def logged(file: Path, log: Log, tally: Tally) -> Iterator[pd.DataFrame]:
    """Chunks of t, roll, pitch, yaw, heave in SI units and radians; NaN for what a sentence does not say."""
    if log.topic is not None and log.topic.upper() not in ATTITUDE:
        allowed = f"of NMEA allowed are {', '.join(ATTITUDE)}"
        raise InputError(f"{file}: measure.log.topic: found {quoted(log.topic)}; {allowed}")
    try:
        with open(file, "rb") as stream:
            head = list(islice(_lines(stream), _HEAD))
        clock = _clock(head, log)
        with open(file, "rb") as stream:
            reader = _Reader(clock, tally, log.topic.upper() if log.topic else None)
            rows: list[tuple[float, ...]] = []
            count = 0
            for line in _lines(stream):
                rows += reader.take(line)
                if len(rows) >= _ROWS:
                    yield _chunk(rows)
                    count, rows = count + len(rows), []
            rows += clock.rest()
            count += len(rows)
            yield _chunk(rows)
    except OSError as error:
        raise unreadable(file, error) from None
    if clock.untimed > count:
        raise InputError(
            f"{file}: no time: no stamps or TAG blocks before the sentences, no times in them (ZDA, PASHR); "
            "set measure.log.rate_hz to the sensor's rate"
        )
    tally.untimed += clock.untimed


def looks_like(head: bytes) -> bool:
    """Whether the first bytes of a file are NMEA sentences, with or without stamps."""
    lines = [line for line in head.splitlines()[:50] if line.strip()]
    return bool(lines) and 2 * sum(parsed_line(line) is not None for line in lines) > len(lines)


@dataclass
class _Reader:
    clock: Clock
    tally: Tally
    chosen: str | None  # the sentence that attitudes are taken from; None until one comes
    heading: float = np.nan  # of a sentence of its own, for the next attitude
    times: TagTimes = field(default_factory=TagTimes)
    partial: dict[str, float] = field(default_factory=dict)  # of XDR sentences that give one angle each

    def take(self, line: bytes) -> list[tuple[float, ...]]:
        """The samples that a line completes."""
        tally = self.tally
        tally.read += 1
        sentence = parsed_line(line)
        if sentence is None:
            tally.garbage += 1
            return []
        name, body, checksum = sentence.name, sentence.body, sentence.checksum
        if not sentence.tagged or (body and not sentence.valid):
            tally.checksum += 1
            if self.chosen and name.endswith(self.chosen):
                self.clock.missed()
            return []
        stamp = self.times.of(sentence)
        kind = name if name in ATTITUDE else name[2:]
        message = _parsed(body, checksum) if kind in (*ATTITUDE, "HDT", "ZDA") else None
        if message is None:
            tally.other += 1
            return []
        if kind == "ZDA":
            tally.other += 1
            return self.clock.zda(message)
        if kind == "HDT":
            tally.other += 1
            self.heading = _number(message, "headingT")
            return []
        attitude = self._attitude(kind, message)
        if attitude is None or (self.chosen or kind) != kind:
            tally.other += 1
            return []
        self.chosen = kind
        heading = self.heading if np.isnan(attitude.heading) else attitude.heading
        self.heading = np.nan
        return self.clock.sample(stamp, attitude.utc, (attitude.roll, attitude.pitch, heading, attitude.heave_down))

    def _attitude(self, kind: str, message: Any) -> Attitude | None:
        if kind == "PSXN":
            if str(getattr(message, "field_01", "")) != "23":
                return None
            roll, pitch, heading, heave = (_number(message, f"field_0{k}") for k in (2, 3, 4, 5))
            return Attitude(kind, roll, pitch, heading, heave)
        if kind == "PRDID":
            pitch, roll, heading = (_number(message, f"field_0{k}") for k in (1, 2, 3))
            return Attitude(kind, roll, pitch, heading)
        if kind == "PASHR":
            if not hasattr(message, "trueHdgInd"):  # Ashtech's own $PASHR,POS and the like
                return None
            t: Any = getattr(message, "utctime", None)
            utc = t.hour * 3600 + t.minute * 60 + t.second + 1e-6 * t.microsecond if hasattr(t, "hour") else np.nan
            roll, pitch, heading = (_number(message, name) for name in ("roll", "pitch", "trueHdg"))
            return Attitude(kind, roll, pitch, heading, utc=utc)
        for k in range(1, 20):
            name = str(getattr(message, f"tdrid_{k:02d}", "")).upper()
            angle = next((full for full, short in _XDR.items() if name.startswith(short)), None)
            if angle and str(getattr(message, f"dataunit_{k:02d}", "")).upper() == "D":
                self.partial[angle] = _number(message, f"data_{k:02d}")
        if len(self.partial) < 2:
            return None
        both, self.partial = self.partial, {}
        return Attitude(kind, both["roll"], both["pitch"])


_XDR = {"roll": ("ROLL", "HEEL"), "pitch": ("PITCH", "PTCH")}


def _chunk(rows: list[tuple[float, ...]]) -> pd.DataFrame:
    t, roll, pitch, heading, heave_down = np.array(rows, dtype=float).reshape(-1, 5).T
    radians = np.deg2rad([roll, -pitch, -heading])
    angles = dict(zip(("roll", "pitch", "yaw"), wrap(radians), strict=True))
    return pd.DataFrame({"t": t, **angles, "heave": -heave_down})


def _clock(head: list[bytes], log: Log) -> Clock:
    times = TagTimes()
    stamps = np.array([times.of(sentence) for line in head if (sentence := parsed_line(line)) is not None])
    known = stamps[np.isfinite(stamps)]
    if 2 * len(known) > len(stamps):
        return FromSeconds() if whole_seconds(known) else FromStamps()
    return FromSentences() if log.rate_hz is None else Nominal(log.rate_hz)


def _lines(stream: BinaryIO) -> Iterator[bytes]:
    while line := stream.readline(_LONGEST):
        line = line.strip()
        if line:
            yield line


def _parsed(body: str, checksum: str) -> Any:
    from pynmeagps import NMEAReader

    try:
        return NMEAReader.parse(f"${body}*{checksum}\r\n".encode())
    except Exception:  # besides its own errors, of sentences that are cut short: IndexError, TypeError and others
        return None


def _number(message: Any, name: str) -> float:
    try:
        value = float(getattr(message, name, np.nan))
    except (TypeError, ValueError):
        return np.nan
    return value if np.isfinite(value) else np.nan
