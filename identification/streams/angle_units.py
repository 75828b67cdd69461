"""Angles of a stream in another unit than they are read in: what the robot as drawn says to either."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurement_table import UNITS
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.registered import drawn_closure, registered
from kincal.identification.streams.columns import ANGLES
from kincal.urdf.description import Column, Measure
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import Closure
from kincal.urdf.rigid_motion import wrap

_LEAST, _MOST = 8, 60  # poses: of fewer W and T explain anything, and more add nothing
_EXPLAINED = 0.1  # of the angles' mean square: a robot whose residuals are smaller explains them
_BETTER = 100.0  # times smaller are the mean squares in the right unit
_OTHER = {"1": "deg", "rad": "deg", "deg": "rad"}
_OF_VECTOR = {"roll": "x", "pitch": "y", "yaw": "z"}  # of a Vector3Stamped
_GROUPS = {"tilt": ("roll", "pitch"), "yaw": ("yaw",)}  # channels whose columns one instrument gives


@dataclass(frozen=True)
class _Fit:
    """Of the robot as drawn, by channel: mean squares of the residuals, and of the angles about their mean [rad2]."""

    residual: Mapping[str, float]
    spread: Mapping[str, float]

    @property
    def size(self) -> float:
        return sum(self.residual.values())

    @property
    def explains(self) -> bool:
        return self.size < _EXPLAINED * sum(self.spread.values())

    def explained(self) -> tuple[str, ...]:
        """Columns of the channels that vary, and as the robot does."""
        telling = (channel for channel in self.residual if self.residual[channel] < _EXPLAINED * self.spread[channel])
        return tuple(name for channel in telling for name in _GROUPS[channel])


def check_units(stream: pd.DataFrame, table: pd.DataFrame, model: ErrorModel, measure: Measure, form: str) -> None:
    """Refuse angles that fit the robot as drawn in another unit, and not in the one that they are read in.

    stream: samples with `pose` and angles [rad]; table: joint values of the poses; form: the stream's format, of which
    NMEA has units of its own. Nothing is refused where the loops do not close at these joint values.
    """
    assert measure.streams is not None
    if form == "nmea":
        return
    table = table[table["pose"].isin(stream["pose"])]
    table = table.iloc[np.unique(np.linspace(0, len(table) - 1, min(len(table), _MOST)).astype(int))]
    columns = {name: _column(name, measure, form) for name in ANGLES if name in stream}
    if len(table) < _LEAST or any(column.unit not in _OTHER for column in columns.values()):
        return
    readings = table[list(model.chain.actuated_names)].to_numpy(float)
    try:
        closure = drawn_closure(model, readings)
    except InputError:
        return
    samples = stream[stream["pose"].isin(table["pose"])]
    present = [channel for channel, names in _GROUPS.items() if names[0] in columns]
    fits: dict[tuple[str, ...], _Fit] = {}
    for changed in product((False, True), repeat=len(present)):
        others = tuple(name for c, other in zip(present, changed, strict=True) if other for name in _GROUPS[c])
        angles = _medians(samples, table["pose"].to_numpy(), columns, others)
        fits[others] = _fit(model, closure, readings, angles)
        if fits[()].explains:
            return
    _refuse(fits, columns, measure.streams)


def _refuse(fits: Mapping[tuple[str, ...], _Fit], columns: Mapping[str, Column], file: Path) -> None:
    changed = min(fits, key=lambda others: fits[others].size)
    read, other = fits[()], fits[changed]
    names = [name for name in changed if name in other.explained()]
    if not names or read.size < _BETTER * other.size:
        return
    units = {name: _OTHER[columns[name].unit] for name in names}
    settings = ", ".join(f'{n} = {{ from = "{columns[n].source}", unit = "{unit}" }}' for n, unit in units.items())
    right, wrong = _words(units.values()), _words(_OTHER[unit] for unit in units.values())
    rest = [name for name in changed if name not in names]
    unknown = f"; kincal cannot decide it for {', '.join(rest)}" if rest else ""
    off = np.rad2deg(np.sqrt(max(other.residual.values())))
    raise InputError(
        f"{file}: {', '.join(names)}: the robot as drawn fits these angles as {right}, not as {wrong} (residuals of "
        f"{off:.2g} degrees{unknown}). In measure.columns set {settings}"
    )


def _words(units: Iterable[str]) -> str:
    return " and ".join(dict.fromkeys({"deg": "degrees", "rad": "radians"}[unit] for unit in units))


def _column(name: str, measure: Measure, form: str) -> Column:
    source = _OF_VECTOR[name] if form == "bag" else name
    return measure.columns.get(name) or Column.model_validate({"from": source})


def _medians(
    samples: pd.DataFrame, poses: np.ndarray, columns: Mapping[str, Column], others: Sequence[str]
) -> dict[str, np.ndarray]:
    """{name: (n,)} [rad] medians of the poses' samples, those of `others` in the other unit."""
    medians = {}
    for name, column in columns.items():
        factor = UNITS[_OTHER[column.unit]] / UNITS[column.unit] if name in others else 1.0
        values = samples[name] * factor
        first = values.groupby(samples["pose"]).transform("first")
        near = (first + wrap((values - first).to_numpy())).groupby(samples["pose"]).median()  # they may cross +-180 deg
        medians[name] = near.loc[poses].to_numpy(float)
    return medians


def _fit(model: ErrorModel, closure: Closure, readings: np.ndarray, angles: Mapping[str, np.ndarray]) -> _Fit:
    """The residual is infinite where no W and T fit."""
    values = {"tilt": np.column_stack([angles["roll"], angles["pitch"]])}
    if "yaw" in angles:
        values["yaw"] = angles["yaw"]
    n = len(readings)
    measured = Measurements(np.arange(n), readings, values, {channel: np.ones(n) for channel in values})
    spread = {c: float(np.mean(np.var(wrap(v - v[:1]), axis=0))) for c, v in values.items()}
    try:
        squares = registered(model, measured, closure).residual ** 2
    except (InputError, CalibrationError, np.linalg.LinAlgError, ValueError):
        return _Fit(dict.fromkeys(values, np.inf), spread)
    channels = named(measured.channels)
    parts = np.split(squares, np.cumsum([c.rows for c in channels])[:-1], axis=1)
    return _Fit({c.name: float(np.mean(part)) for c, part in zip(channels, parts, strict=True)}, spread)
