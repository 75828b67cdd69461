"""RAO tables from files: kincal's own (CSV or Parquet), and the vessel structures of the Marine Systems Simulator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.constants import knot

from kincal.pipeline.sea.rao import MODES, RaoTable
from kincal.urdf.description import Column, listed
from kincal.urdf.errors import InputError, quoted, shortened
from kincal.urdf.input_files import bounded, check_file

if TYPE_CHECKING:
    import pandas as pd

_ANGLES = MODES[3:]
_ODD = np.array([1, -1, 1, -1, 1, -1])  # of a ship with port like starboard, in waves from the other side
_MSS_AXES = np.array([1, -1, -1, 1, -1, -1])  # x forward, y to starboard, z down -> x forward, y to port, z up
_MAX_MATLAB = 64 << 20  # bytes of a file
_WIDEST = np.deg2rad(45.0)  # between tabulated directions


def _columns(mode: str) -> tuple[str, str]:
    """Amplitude [m/m or deg/m] and phase lead [deg]."""
    return (f"{mode}_deg" if mode in _ANGLES else mode), f"{mode}_phase_deg"


_KNOWN = ("frequency", "direction_deg", "speed_knots", *(name for mode in MODES for name in _columns(mode)))


def read_rao(file: Path, speed: float) -> RaoTable:
    """The table for a speed [m/s]: of several tabulated speeds the nearest; one alone is taken for all.

    Raises InputError for a file that is no such table, or a speed outside those of the table.
    """
    if file.suffix.lower() == ".mat":
        frequency, direction, speeds, values = _mss(file)
    else:
        frequency, direction, speeds, values = _own(file)
    if len(speeds) > 1 and not speeds.min() - 1e-6 <= speed <= speeds.max() + 1e-6:
        speed_range = f"{speeds.min() / knot:.3g} to {speeds.max() / knot:.3g} knots"
        raise InputError(f"{file}: speed_knots = {speed / knot:.3g}: the table has {speed_range}")
    direction, values = _around(direction, values[np.abs(speeds - speed).argmin()], file)
    return RaoTable(frequency, direction, values)


def _own(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """frequency (f,), direction (d,), speeds (s,), values (s, f, d, 6) of kincal's own table."""
    from kincal.identification.table_files import load
    from kincal.urdf.description import Measure

    raw = load(file, Measure(), _KNOWN)
    if raw.empty:
        raise InputError(f"{file}: it has no row; needed are at least two frequencies, and directions")
    for name in raw.columns:
        if name not in _KNOWN:
            raise InputError(f"{file}: unknown column {quoted(name)}; allowed are {', '.join(_KNOWN)}")
    speed = _column(raw, "speed_knots", file) * knot if "speed_knots" in raw else np.zeros(len(raw))
    at = [speed, _column(raw, "frequency", file), np.deg2rad(_column(raw, "direction_deg", file))]
    axes = [np.unique(values) for values in at]
    shape = tuple(len(axis) for axis in axes)
    where = np.ravel_multi_index([np.searchsorted(axis, v) for axis, v in zip(axes, at, strict=True)], shape)
    if len(raw) != np.prod(shape) or np.unique(where).size != len(raw):
        raise InputError(
            f"{file}: {len(raw)} rows of {shape[0]} speeds, {shape[1]} frequencies and {shape[2]} directions; "
            f"allowed is each combination once ({np.prod(shape)} rows)"
        )
    values = np.zeros((len(raw), 6), dtype=complex)
    for index, mode in enumerate(MODES):
        amplitude, phase = _columns(mode)
        if amplitude in raw or phase in raw or mode in ("heave", "roll", "pitch"):
            size = _column(raw, amplitude, file) * (np.pi / 180 if mode in _ANGLES else 1.0)
            values[where, index] = size * np.exp(1j * np.deg2rad(_column(raw, phase, file)))
    return _checked(axes[1], file), axes[2], axes[0], values.reshape(*shape, 6)


def _column(raw: pd.DataFrame, name: str, file: Path) -> np.ndarray:
    from kincal.identification.measurement_table import numbers

    if name not in raw:
        raise InputError(f"{file}: column {quoted(name)} is missing; it has {listed(raw.columns)}")
    return numbers(raw[name].tolist(), Column.model_validate({"from": name}), file)


def _mss(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same of a .mat file with a `vessel` whose motionRAO has amp, phase (6 of (f, d, 10)) and w (f,).

    Phases lead the wave's crest; a heading is where waves travel to, from the bow towards starboard; axes are x
    forward, y to starboard, z down. The last of the ten speeds are empty.
    """
    from scipy.io import loadmat

    check_file(file, _MAX_MATLAB)
    try:
        with bounded(file):
            content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except InputError:
        raise
    except Exception as error:  # of a damaged file scipy's reader raises whatever it stumbles over
        raise InputError(f"{file}: not a MATLAB file that can be read: {shortened(error)}") from None
    try:
        vessel = content["vessel"]
        rao, headings, speeds = vessel.motionRAO, vessel.headings, np.atleast_1d(vessel.velocities).astype(float)
        amplitude, phase = (np.stack(list(part), axis=-1).astype(float) for part in (rao.amp, rao.phase))
        frequency = np.asarray(rao.w, dtype=float)
    except (KeyError, AttributeError, TypeError, ValueError) as error:
        why = f"no vessel structure with motionRAO.amp, .phase and .w: {shortened(error)}"
        raise InputError(f"{file}: {why}") from None
    if amplitude.ndim == 3:  # a single speed's axis is squeezed away
        amplitude, phase = amplitude[:, :, None], phase[:, :, None]
    expected = (len(frequency), len(headings))
    if amplitude.shape[:2] != expected or amplitude.shape != phase.shape or amplitude.shape[2] < len(speeds):
        raise InputError(f"{file}: motionRAO.amp is {amplitude.shape[:3]}; w and headings allow {expected}")
    values = (amplitude * np.exp(1j * phase) * _MSS_AXES)[:, :, : len(speeds)]
    if not np.isfinite(values).all():
        raise InputError(f"{file}: motionRAO has values that are no finite numbers")
    direction = np.mod(-np.asarray(headings, dtype=float), 2 * np.pi)
    order = np.argsort(direction)
    return _checked(frequency, file), direction[order], speeds, np.moveaxis(values, 2, 0)[:, :, order]


def _checked(frequency: np.ndarray, file: Path) -> np.ndarray:
    if len(frequency) < 2 or frequency[0] <= 0 or np.any(np.diff(frequency) <= 0):
        raise InputError(f"{file}: frequencies: allowed are two or more, greater than 0 and increasing [rad/s]")
    return frequency


def _around(direction: np.ndarray, values: np.ndarray, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Directions (d,) in [0, 2 pi) and values (f, d, 6) of the whole circle; 0 to 180 degrees are mirrored."""
    turn = 2 * np.pi
    if direction.min() >= 0 and np.isclose(direction.max(), np.pi) and np.isclose(direction.min(), 0):
        inner = slice(-2, 0, -1)
        direction = np.concatenate([direction, turn - direction[inner]])
        values = np.concatenate([values, values[:, inner] * _ODD], axis=1)
    gaps = np.diff(np.append(direction, direction[0] + turn))
    if direction.min() < 0 or direction.max() >= turn or gaps.max() > _WIDEST + 1e-9:
        raise InputError(
            f"{file}: directions {np.rad2deg(direction.min()):g} to {np.rad2deg(direction.max()):g} degrees: allowed "
            "are 0 to 180, or those of the whole circle below 360, at most 45 degrees apart"
        )
    return direction, values
