"""What was wrong with a stream: every record that was read is a good sample, holds none, or is counted as one fault."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from kincal.urdf.errors import InputError, quoted

_FAULTS = {
    "garbage": "are no readable record",
    "checksum": "fail their checksum",
    "untimed": "come before any time",
    "not_finite": "have no number for t, roll or pitch",
    "unposed": "have no whole number for pose",
    "jumped": "have a time far ahead that the next ones deny",
    "repeated": "repeat a time",
    "backwards": "run back in time",
    "frozen": "have a stuck or saturated roll or pitch",
    "incomplete": "lack a channel that most have",
}


@dataclass(frozen=True)
class StreamHealth:
    """Counts of a whole file: read = samples + other + garbage + .. + incomplete."""

    file: str
    format: str
    read: int  # lines, rows or messages
    samples: int  # good ones
    other: int  # well-formed records that hold no attitude
    garbage: int
    checksum: int
    untimed: int
    not_finite: int
    unposed: int  # of a stream with a pose column, as `incomplete` and `sparse`
    jumped: int
    repeated: int
    backwards: int
    frozen: int
    incomplete: int
    stuck: dict[str, int]  # samples a channel: it repeats one value for longer than its resolution explains
    saturated: dict[str, int]  # the same at the channel's largest or smallest value
    constant: tuple[str, ...]  # channels that never change
    sparse: tuple[str, ...]  # channels that were left out, since many samples lack them
    gaps: int  # longer than five sample intervals
    longest_gap: float  # [s]
    clock_steps: int  # the clock was set back; later times are shifted to run on
    shift: float  # [s] by how much in all
    notes: tuple[str, ...] = ()  # what else a user should know of the file

    @property
    def bad(self) -> int:
        return self.read - self.samples - self.other

    def lines(self) -> tuple[str, ...]:
        """One line each of what is wrong; empty for a clean stream."""
        lines = [f"{n} of {self.read} records {text}" for name, text in _FAULTS.items() if (n := getattr(self, name))]
        for text, counts in (("stuck", self.stuck), ("saturated", self.saturated)):
            lines += [f"channel {quoted(channel)} is {text} for {n} samples" for channel, n in counts.items()]
        lines += [f"channel {quoted(channel)} never changes" for channel in self.constant]
        lines += [f"channel {quoted(channel)} is left out: too many samples lack it" for channel in self.sparse]
        if self.gaps:
            lines.append(f"{self.gaps} gaps, the longest {self.longest_gap:.3g} s")
        if self.clock_steps:
            shifted = f"; later times were shifted by {self.shift:.6g} s" if self.shift else ""
            lines.append(f"the clock was set back {self.clock_steps} times{shifted}")
        return (*self.notes, *lines)

    def require(self, file: Path) -> StreamHealth:
        """Itself, unless the file is mostly garbage (more than half of its records) or has no sample: InputError."""
        if self.samples and 2 * self.bad <= self.read:
            return self
        counts = "; ".join(self.lines()) or f"{self.other} of {self.read} records hold no attitude"
        raise InputError(
            f"{file}: {self.samples} of {self.read} records are good samples of a {self.format} stream ({counts}); "
            "allowed are at most as many bad records as good ones"
        )


@dataclass
class Tally:
    """The counts while a file is being read."""

    read: int = 0
    samples: int = 0
    other: int = 0
    garbage: int = 0
    checksum: int = 0
    untimed: int = 0
    not_finite: int = 0
    unposed: int = 0
    jumped: int = 0
    repeated: int = 0
    backwards: int = 0
    frozen: int = 0
    incomplete: int = 0
    stuck: dict[str, int] = field(default_factory=dict)
    saturated: dict[str, int] = field(default_factory=dict)
    constant: tuple[str, ...] = ()
    sparse: tuple[str, ...] = ()
    gaps: int = 0
    longest_gap: float = 0.0
    clock_steps: int = 0
    shift: float = 0.0
    notes: tuple[str, ...] = ()

    def health(self, file: str, format: str) -> StreamHealth:
        return StreamHealth(file, format, **vars(self))
