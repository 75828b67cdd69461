"""Joint values in a table of their own, `measure.joints`, beside a table of measurements that has none.

Of an export with frames, each row says which frames its pose is: `frame`, or `frame_from` and `frame_to`, or `t_from`
and `t_to` [s]. A pose is the mean of its frames. Else rows go together by `pose`, or in their order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from kincal.identification.channels.orientation import QUATERNION
from kincal.identification.column_names import matched
from kincal.identification.table_files import floats, load
from kincal.identification.table_formats.export import POSITION
from kincal.urdf.description import Measure, listed
from kincal.urdf.errors import TableError, quoted

FRAMES = (("frame", "frame"), ("frame_from", "frame_to"), ("t_from", "t_to"))  # first and last of a pose
_COLUMNS = tuple(dict.fromkeys(name for pair in FRAMES for name in pair))


def with_joints(measured: pd.DataFrame, joints: Sequence[str], measure: Measure, file: Path | str) -> pd.DataFrame:
    """The measured table with one row a pose of measure.joints. Raises InputError.

    joints: names of their columns in measure.joints.
    """
    assert measure.joints is not None
    settings = measure if "export" in measured.attrs else measure.model_copy(update={"header_row": None})
    rows = load(measure.joints, settings, (*joints, *_COLUMNS))
    columns = matched(list(rows.columns), ("pose", *joints, *_COLUMNS))
    missing = [name for name in joints if name not in columns]
    if missing:
        raise TableError(
            f"{measure.joints}: column {quoted(missing[0])} is missing; it has {listed(rows.columns)}", missing[0]
        )
    poses = rows[columns["pose"]].tolist() if "pose" in columns else list(range(len(rows)))
    first, last, windows = _places(measured, rows, columns, measure.joints, file)
    in_order = f"its rows go together with those of {measure.joints}, in their order"
    values, notes = measured.iloc[first], [in_order] if "pose" not in measured else []
    if windows:
        values, notes = _means(measured, first, last, poses)
    values = values.drop(columns=["pose", *joints, "frame", "t"], errors="ignore").reset_index(drop=True)
    table = pd.concat([pd.DataFrame({"pose": poses}), rows[[columns[name] for name in joints]], values], axis=1)
    units = {**measured.attrs.get("units", {}), **rows.attrs.get("units", {})}
    remarks = (*measured.attrs.get("notes", ()), *rows.attrs.get("notes", ()), *(f"{file}: {note}" for note in notes))
    table.attrs.update(notes=remarks, units=units)
    return table


def _places(
    measured: pd.DataFrame, rows: pd.DataFrame, columns: Mapping[str, str], source: Path, file: Path | str
) -> tuple[np.ndarray, np.ndarray, bool]:
    """(n,) first and one past the last row of each pose, and whether frames were named."""
    pair = next((pair for pair in FRAMES if set(pair) <= set(columns)), None)
    if pair is not None and "export" in measured.attrs:
        return *_window(measured, rows, columns, pair, source), True
    if pair is not None:
        raise TableError(f"{source}: it has {' and '.join(dict.fromkeys(pair))}, but {file} is no export with frames")
    if "pose" in columns and "pose" in measured:
        order = pd.Index(floats(measured["pose"])).get_indexer(pd.Index(floats(rows[columns["pose"]])))
        if (order < 0).any():
            row = int(np.argmax(order < 0))
            raise TableError(
                f"{source}: row {row + 1}: {file} has no pose {rows[columns['pose']].iloc[row]}", "pose", row
            )
        return order, order + 1, False
    if len(rows) != len(measured):
        frames = "frame (or frame_from and frame_to, or t_from and t_to)" if "export" in measured.attrs else "pose"
        raise TableError(
            f"{source}: {len(rows)} rows for {len(measured)} rows of {file}: which go together? Add the column {frames}"
        )
    order = np.arange(len(rows))
    return order, order + 1, False


def _window(
    measured: pd.DataFrame, rows: pd.DataFrame, columns: Mapping[str, str], pair: tuple[str, str], source: Path
) -> tuple[np.ndarray, np.ndarray]:
    scale = measured["t" if pair[0] == "t_from" else "frame"].to_numpy(float)
    begin, end = (floats(rows[columns[name]]) for name in pair)
    known = np.isfinite(scale)
    if not known.all() or (np.diff(scale) <= 0).any():
        raise TableError(f"{source}: {pair[0]} can't be used: the export's frames or times do not increase")
    first, last = np.searchsorted(scale, begin, side="left"), np.searchsorted(scale, end, side="right")
    bad = np.flatnonzero(~(np.isfinite(begin) & np.isfinite(end)) | (last <= first))
    if len(bad):
        row = int(bad[0])
        shown = " and ".join(f"{name} = {rows[columns[name]].iloc[row]}" for name in dict.fromkeys(pair))
        span = f"{scale[0]:g} to {scale[-1]:g}" if len(scale) else "none"
        raise TableError(f"{source}: row {row + 1}: {shown}: no frame there; the export has {span}", pair[0], row)
    return first, last


def _means(
    measured: pd.DataFrame, first: np.ndarray, last: np.ndarray, poses: Sequence[object]
) -> tuple[pd.DataFrame, list[str]]:
    """Mean poses of the frames without gaps; NaN where there are none. Notes say how much frames of a pose differ."""
    names = [*POSITION, *(name for name in QUATERNION if name in measured)]
    values, result = measured[names].to_numpy(float), np.full((len(first), len(names)), np.nan)
    spread = np.zeros((len(first), 2))  # [m], [rad]
    for k, (begin, end) in enumerate(zip(first, last, strict=True)):
        window = values[begin:end]
        window = window[np.isfinite(window).all(axis=1)]
        if len(window):
            result[k], spread[k] = _mean(window)
    counts = last - first
    notes = []
    if counts.max(initial=1) > 1:
        worst = spread.argmax(axis=0)
        turn = f" and {np.rad2deg(spread[worst[1], 1]):.2g} deg (pose {poses[worst[1]]})" if len(names) > 3 else ""
        notes.append(
            f"poses are means of {counts.min()} to {counts.max()} frames; within a pose they scatter by up to "
            f"{1e3 * spread[worst[0], 0]:.2g} mm (pose {poses[worst[0]]}){turn}"
        )
    return pd.DataFrame(result, columns=names), notes


def _mean(window: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Of poses (m, 3 or 7): the mean, and the root mean square of distances and angles to it."""
    position = window[:, :3].mean(axis=0)
    distance = float(np.sqrt(np.square(window[:, :3] - position).sum(axis=1).mean()))
    if window.shape[1] == 3:
        return position, (distance, 0.0)
    rotation = Rotation.from_quat(window[:, 3:])
    mean = rotation.mean()
    angle = float(np.sqrt(np.square((mean.inv() * rotation).magnitude()).mean()))
    return np.concatenate([position, mean.as_quat(canonical=True)]), (distance, angle)
