r"""Lines of an NMEA log: a logger's stamp, NMEA 4 TAG blocks, and the sentence with its checksum.

A TAG block stands before its sentence: `\s:mru1,c:1700000000*hh\$GPHDT,..`. Its field c is the time since 1970. Of a
group of sentences (field g) only the first needs a time. A block may also have a line of its own, before its sentence.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from kincal.identification.time_stamps import seconds_of

_BLOCK = re.compile(r"\\([^\\]*)\\")
_LEAST = 4  # letters of a sentence's name


@dataclass(frozen=True)
class Sentence:
    """One line. body: from the name to before the checksum, empty for a line with TAG blocks alone."""

    stamp: float  # [s] of a TAG block, else the logger's; NaN: neither
    body: str
    checksum: str
    group: str = ""  # of sentences that share one time
    tagged: bool = True  # whether the checksums of all TAG blocks are right

    @property
    def name(self) -> str:
        return self.body.split(",", 1)[0]

    @property
    def valid(self) -> bool:
        return sums_up(self.body, self.checksum)


@dataclass
class TagTimes:
    """Times that a TAG block gives to sentences on other lines."""

    pending: float = np.nan  # [s] of a line with TAG blocks alone, for the next sentence
    groups: dict[str, float] = field(default_factory=dict)  # {group: s}, the last one alone

    def of(self, sentence: Sentence) -> float:
        """[s] a sentence's time; NaN where no stamp gives one."""
        stamp = sentence.stamp
        if np.isnan(stamp) and sentence.group:
            stamp = self.groups.get(sentence.group, np.nan)
        if np.isnan(stamp):
            stamp = self.pending
        self.pending = stamp if not sentence.body else np.nan
        if sentence.group and np.isfinite(stamp):
            self.groups = {sentence.group: stamp}
        return stamp


def parsed_line(line: bytes) -> Sentence | None:
    """The sentence or the TAG blocks of a line; None where it has neither."""
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        return None
    before, start, rest = re.fullmatch(r"([^$!]*)([$!]?)(.*)", text, re.DOTALL).groups()  # type: ignore[union-attr]
    body, _, checksum = rest.partition("*")
    blocks = _BLOCK.findall(before)
    plausible = len(body.split(",", 1)[0]) >= _LEAST and "," in body and body.isprintable() if start else blocks
    if not plausible:
        return None
    stamp, group, tagged = _read(blocks)
    if np.isnan(stamp):
        stamp = seconds_of(_BLOCK.sub("", before).strip().rstrip(",;").strip())
    return Sentence(stamp, body, checksum, group, tagged)


def sums_up(body: str, checksum: str) -> bool:
    """Whether a checksum is the exclusive or of all letters before it."""
    expected = reduce(lambda a, b: a ^ b, body.encode(), 0)
    return len(checksum) == 2 and f"{expected:02X}" == checksum.upper()


def _read(blocks: list[str]) -> tuple[float, str, bool]:
    """Time [s], group, and whether all checksums are right, of the TAG blocks of a line."""
    stamp, group, good = np.nan, "", True
    for block in blocks:
        fields, _, checksum = block.rpartition("*")
        if not sums_up(fields, checksum):
            good = False
            continue
        values = dict(part.split(":", 1) for part in fields.split(",") if ":" in part)
        stamp = seconds_of(values["c"]) if "c" in values else stamp
        group = values["g"].rsplit("-", 1)[-1] if "g" in values else group
    return stamp, group, good
