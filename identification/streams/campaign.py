"""How a campaign went that was measured by a sensor's stream: what a report says of it."""

from __future__ import annotations

from dataclasses import dataclass

from kincal.identification.streams.health import StreamHealth


@dataclass(frozen=True)
class DroppedPose:
    pose: int
    reason: str

    def __str__(self) -> str:
        return f"pose {self.pose} was left out: {self.reason}"


@dataclass(frozen=True)
class ClockOffset:
    """By how much the stream's clock is ahead of the command log's: estimated from motions, or stated."""

    seconds: float
    paired: int = 0  # motions; 0: stated
    scatter: float = 0.0  # [s] of the pairs, one sigma


@dataclass(frozen=True)
class Campaign:
    health: StreamHealth
    offset: ClockOffset | None  # None: the stream says itself which pose a sample is of
    commanded: int  # poses
    kept: int
    dropped: tuple[DroppedPose, ...]

    @property
    def summary(self) -> str:
        offset, health = self.offset, self.health
        if offset is None:
            return f"{health.file} ({health.format}): {health.samples} good samples, for {self.commanded} poses."
        method = f"found from {offset.paired} motions, scatter {offset.scatter:.2f} s" if offset.paired else "as stated"
        return (
            f"{health.file} ({health.format}): {health.samples} good samples; its clock is {offset.seconds:.2f} s "
            f"ahead of the commands' ({method}); {self.kept} of {self.commanded} commanded poses were used."
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line each."""
        lines = [f"{self.health.file}: {line}" for line in self.health.lines()]
        return (*lines, *map(str, self.dropped))
