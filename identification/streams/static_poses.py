"""A stream and a command log -> the stretches of each commanded pose in which the sensor was still."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import UNITS
from kincal.identification.streams.campaign import Campaign, ClockOffset, DroppedPose
from kincal.identification.streams.clock_offset import estimate_offset, misfit
from kincal.identification.streams.columns import ANGLES, OPTIONAL
from kincal.identification.streams.commands import Holds, read_commands
from kincal.identification.streams.reading import complete, open_stream
from kincal.identification.streams.repeats import STUCK
from kincal.identification.streams.stillness import Bins, binned
from kincal.identification.streams.windows import Window, still_windows
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.input_files import kept

_LEAST = 5  # samples a pose
_LONGER = 100  # times: one file lasts so much longer that its time may count smaller units
TICKS = ("ms", "us", "ns")


@dataclass(frozen=True)
class StaticPoses:
    """What a log gives: one row a kept pose, their samples, and what was left out."""

    table: pd.DataFrame  # pose, and the joints' readings as commanded
    stream: pd.DataFrame  # t [s], pose, angles [rad] and further channels: the still samples of the kept poses
    campaign: Campaign


def static_poses(measure: Measure, joints: Sequence[str]) -> StaticPoses:
    """The poses of measure.streams and measure.commands. The stream is read twice: to find the stretches, to take them.

    Raises InputError as the readers do, and where no pose is left.
    """
    assert measure.streams is not None
    assert measure.commands is not None
    log, file = measure.log, measure.streams
    holds = read_commands(measure.commands, joints, measure)
    stream = open_stream(file, measure)
    bins = binned(stream, file)
    bins, offset = _clocks(bins, holds, file, log)
    windows, dropped = still_windows(bins, holds, offset.seconds, log)
    inside = _within(file, stream, windows)
    whole = complete(inside)
    health = replace(stream.health, sparse=_sparse(inside, whole, measure))
    samples = _telling(whole, measure)
    dropped += _unusable(samples, [w.pose for w in windows])
    bad = {d.pose for d in dropped}
    rows = [w.row for w in windows if w.pose not in bad]
    if not rows:
        reasons = "; ".join(f"pose {d.pose}: {d.reason}" for d in dropped[:3])
        raise InputError(f"{file}: none of {len(holds)} commanded poses is left: {reasons}")
    table = pd.DataFrame({"pose": holds.pose[rows]} | {n: holds.joints[rows, k] for k, n in enumerate(joints)})
    used = samples.loc[~np.isin(samples["pose"], sorted(bad))].reset_index(drop=True)
    left_out = tuple(sorted(dropped, key=lambda d: d.pose))
    return StaticPoses(table, used, Campaign(health, offset, len(holds), len(table), left_out))


def _clocks(bins: Bins, holds: Holds, file: Path, log: Log) -> tuple[Bins, ClockOffset]:
    """The clocks' offset, and the bins by which it is known.

    Angles that span more than half a turn may be degrees: the commands tell. What is in the file stays as it is read.
    """
    fits: list[tuple[float, Bins, ClockOffset]] = []
    errors: list[InputError] = []
    for candidate in (bins, bins.from_degrees()) if bins.beyond else (bins,):
        try:
            stated = log.offset_seconds
            offset = _offset(candidate, holds, file) if stated is None else ClockOffset(stated)
            fits.append((misfit(candidate, holds, offset.seconds), candidate, offset))
        except InputError as error:
            errors.append(error)
    if not fits:
        raise errors[0]
    return min(fits, key=lambda fit: fit[0])[1:]


def _offset(bins: Bins, holds: Holds, file: Path) -> ClockOffset:
    """The clocks' offset. Where none fits and one file lasts far longer, the refusal asks for the unit of its time."""
    try:
        return estimate_offset(bins, holds, file)
    except InputError as error:
        lasted = [float(np.ptp(t)) if len(t) else 0.0 for t in (bins.start, holds.begin)]
        ratio = lasted[0] / lasted[1] if min(lasted) > 0 else 1.0
        unit = min(TICKS, key=lambda unit: abs(np.log10(max(ratio, 1 / ratio) * UNITS[unit])))
        if max(ratio, 1 / ratio) < _LONGER:
            raise
        name = "log" if ratio > 1 else "command log"
        raise InputError(
            f"{error}. The log lasts {lasted[0]:.3g} s, the commands {lasted[1]:.3g} s. Is the time of the {name} in "
            f'{unit}? Then name that column t_{unit} and set measure.columns.t = {{from = "t_{unit}", unit = "{unit}"}}'
        ) from None


def _within(file: Path, chunks: Iterable[pd.DataFrame], windows: list[Window]) -> pd.DataFrame:
    """The samples inside the windows, with their pose."""
    begin, end, pose = (np.array([getattr(w, name) for w in windows]) for name in ("begin", "end", "pose"))

    def inside(chunk: pd.DataFrame) -> pd.DataFrame:
        t = chunk["t"].to_numpy(float)
        k = np.searchsorted(begin, t, side="right") - 1
        good = (k >= 0) & (t < np.append(end, -np.inf)[k])
        part = chunk[good].copy()
        part.insert(1, "pose", pose[k[good]])
        return part

    parts = [part for part in kept(file, map(inside, chunks)) if len(part)]
    return pd.concat(parts) if parts else pd.DataFrame({"t": [], "pose": []})


def _sparse(inside: pd.DataFrame, whole: pd.DataFrame, measure: Measure) -> tuple[str, ...]:
    """Channels that some samples have, and that are left out since too many lack them; none that nobody asks for."""
    wanted = measure.channels is None or "yaw" in measure.channels
    gone = [str(name) for name in inside if name not in whole and inside[name].notna().any()]
    return tuple(name for name in gone if wanted or name != "yaw")


def _telling(samples: pd.DataFrame, measure: Measure) -> pd.DataFrame:
    """Without optional channels that in most poses don't change: no instrument is behind them (a heading of 0), or its
    resolution hides its noise; and without a yaw that is not wanted (measure.channels)."""
    optional = [name for name in samples if name in OPTIONAL]
    values = samples.groupby("pose")[optional].nunique()
    gone = [name for name in optional if np.mean(values[name] == 1) > 0.5]
    if "yaw" in optional and measure.channels is not None and "yaw" not in measure.channels:
        gone.append("yaw")
    return samples.drop(columns=gone)


def _unusable(samples: pd.DataFrame, poses: list[int]) -> list[DroppedPose]:
    """Poses with too few samples, and those in which a channel is stuck."""
    pose, count = np.unique(samples["pose"], return_counts=True)
    counts = dict(zip(pose.tolist(), count.tolist(), strict=True))
    dropped = {
        p: f"{counts.get(p, 0)} good samples; allowed are at least {_LEAST}" for p in poses if counts.get(p, 0) < _LEAST
    }
    values = samples.groupby("pose")[[c for c in ANGLES if c in samples]].nunique()
    for channel in values:
        for p in pose[(np.asarray(values[channel]) == 1) & (count >= STUCK)].tolist():
            dropped[p] = f"channel {quoted(channel)} is stuck for all {counts[p]} samples"
    return [DroppedPose(p, reason) for p, reason in dropped.items()]
