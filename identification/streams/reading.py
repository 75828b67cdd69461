"""A sensor's stream, whatever its format, as chunks of good samples. A log takes no more memory where it is longer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.streams import bags, nmea, tables
from kincal.identification.streams.columns import OPTIONAL, REQUIRED
from kincal.identification.streams.health import StreamHealth, Tally
from kincal.identification.streams.pose_column import all_of_pose, in_order, not_revisited, whole_numbers
from kincal.identification.streams.repeats import Repeats
from kincal.identification.streams.timeline import Timeline
from kincal.identification.time_stamps import FARTHEST
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError
from kincal.urdf.input_files import check_file, check_records, kept, unreadable

_MOSTLY = 0.9  # of the samples: an optional channel that fewer have is left out


@dataclass
class Stream:
    """Chunks of t [s], roll, pitch [rad] and what else the file has (see OPTIONAL; NaN where a sample lacks it).

    After the last chunk `health` says what was wrong; InputError then for a file that is mostly garbage. A file with a
    pose column comes in one chunk, `pose` with it, and complete.
    """

    file: Path
    measure: Measure
    form: str
    by_pose: bool
    _tally: Tally = field(default_factory=Tally)
    _repeats: dict[str, Repeats] = field(default_factory=dict)
    _health: StreamHealth | None = None

    def __iter__(self) -> Iterator[pd.DataFrame]:
        self._tally, self._repeats, self._health = Tally(), {}, None
        for chunk in self._by_pose() if self.by_pose else self._cleaned():
            self._tally.samples += len(chunk)
            check_records(self.file, self._tally.read)
            yield chunk
        self._tally.constant = tuple(name for name, channel in self._repeats.items() if channel.constant)
        self._health = self._tally.health(self.file.name, self.form).require(self.file)

    @property
    def health(self) -> StreamHealth:
        assert self._health is not None, "the stream was not read to its end"
        return self._health

    def _raw(self) -> Iterator[pd.DataFrame]:
        if self.form == "nmea":
            return nmea.logged(self.file, self.measure.log, self._tally)
        if self.form == "bag":
            return bags.logged(self.file, self.measure, self._tally)
        return tables.logged(self.file, self.measure, self.form, self.by_pose, self._tally)

    def _cleaned(self) -> Iterator[pd.DataFrame]:
        timeline = Timeline(self._tally)
        raw = None
        for raw in self._raw():
            yield self._unfrozen(timeline.feed(self._finite(raw)))
        if raw is not None:
            yield self._unfrozen(timeline.feed(raw.iloc[:0], final=True))

    def _by_pose(self) -> Iterator[pd.DataFrame]:
        """All samples at once: a pose's may stand anywhere in the file."""
        whole = together(list(kept(self.file, (self._posed(self._finite(raw)) for raw in self._raw()))))
        if not len(whole):
            return
        unfrozen = self._unfrozen(in_order(whole, self._tally))
        samples = complete(unfrozen)
        self._tally.incomplete = len(unfrozen) - len(samples)
        self._tally.sparse = tuple(str(name) for name in unfrozen if name not in samples)
        yield samples

    def _finite(self, chunk: pd.DataFrame) -> pd.DataFrame:
        far = np.abs(chunk.to_numpy(float)) >= FARTHEST  # beyond it a number is no time, no angle, nor a pose's
        if far.any():
            chunk = chunk.mask(far)
        good = np.all(np.isfinite(chunk[list(REQUIRED)].to_numpy(float)), axis=1)
        self._tally.not_finite += int((~good).sum())
        return chunk.iloc[good]

    def _posed(self, chunk: pd.DataFrame) -> pd.DataFrame:
        good = whole_numbers(chunk["pose"].to_numpy(float))
        self._tally.unposed += int((~good).sum())
        return chunk.iloc[good]

    def _unfrozen(self, chunk: pd.DataFrame) -> pd.DataFrame:
        """Without samples of a stuck or saturated roll or pitch; other channels lose the value alone."""
        frozen, tally = np.zeros(len(chunk), dtype=bool), self._tally
        pose = chunk["pose"].to_numpy(float) if self.by_pose else None
        for name in [c for c in chunk if c not in ("t", "pose")]:
            values = chunk[name].to_numpy(float)
            stuck, saturated = self._repeats.setdefault(str(name), Repeats()).mark(values)
            if pose is not None:
                stuck = not_revisited(stuck, values, pose)
            for counts, bad in ((tally.stuck, stuck), (tally.saturated, saturated)):
                if bad.any():
                    counts[str(name)] = counts.get(str(name), 0) + int(bad.sum())
            either = stuck | saturated
            if pose is not None:
                either &= ~all_of_pose(either, pose)
            if name in REQUIRED:
                frozen |= either
            elif either.any():
                chunk = chunk.assign(**{str(name): chunk[name].mask(either)})
        tally.frozen += int(frozen.sum())
        return chunk.iloc[~frozen]


def open_stream(file: Path, measure: Measure) -> Stream:
    """A log's chunks, its format told by measure.log.format, its content or its extension.

    Raises InputError for a file that can't be read or is of no known format; reading the chunks may raise it, too.
    """
    if not file.is_dir():
        check_file(file)
    form = measure.log.format or _format(file)
    table = form in ("csv", "parquet")
    # with a command log, time says which pose a sample is of
    by_pose = table and measure.commands is None and tables.has_pose(file, measure, form)
    return Stream(file, measure, form, by_pose)


def read_log(file: Path, measure: Measure) -> tuple[pd.DataFrame, StreamHealth]:
    """A whole stream: the samples of all chunks together, and what was wrong with the file.

    An optional channel is kept where nine samples in ten have it, and then those without it are left out.
    """
    stream = open_stream(file, measure)
    return complete(together(list(kept(file, stream)))), stream.health


def read_stream(file: Path, measure: Measure) -> tuple[pd.DataFrame, StreamHealth]:
    """A stream that says of each sample which pose it is of, and its health. Raises InputError for any other stream."""
    stream = open_stream(file, measure)
    if stream.form not in ("csv", "parquet"):
        raise InputError(
            f"{file}: a {stream.form} log does not say which pose a sample is of; set measure.commands to a command log"
        )
    by_pose = replace(stream, by_pose=True)  # a missing pose column is said as any other
    return together(list(by_pose)), by_pose.health


def together(chunks: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(chunks, ignore_index=True) if chunks else pd.DataFrame({name: np.zeros(0) for name in REQUIRED})


def complete(samples: pd.DataFrame) -> pd.DataFrame:
    """Without the optional channels that many samples lack, and without the samples that lack one of the others."""
    lacking = [name for name in samples if name in OPTIONAL and np.mean(samples[name].notna()) < _MOSTLY]
    return samples.drop(columns=lacking).dropna().reset_index(drop=True)


def _format(file: Path) -> str:
    """By content, else by extension."""
    if file.is_dir():
        return "bag"
    try:
        with open(file, "rb") as stream:
            head = stream.read(8192)
    except OSError as error:
        raise unreadable(file, error) from None
    magic = {b"PAR1": "parquet", b"#ROSBAG V2.0": "bag", b"\x89MCAP0\r\n": "bag", b"SQLite format 3\0": "bag"}
    for start, form in magic.items():
        if head.startswith(start):
            return form
    if nmea.looks_like(head):
        return "nmea"
    suffix = file.suffix.lower()
    known = {".parquet": "parquet", ".pq": "parquet", ".bag": "bag", ".mcap": "bag", ".db3": "bag", ".nmea": "nmea"}
    known |= dict.fromkeys((".csv", ".txt", ".tsv"), "csv")
    if suffix not in known and b"\0" in head:
        raise InputError(f"{file}: no known format: allowed are CSV, Parquet, NMEA 0183, ROS bags and MCAP")
    return known.get(suffix, "csv")
