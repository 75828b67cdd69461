"""A recorded motion, as if it happened again: resampled, with its rates and accelerations."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.urdf.errors import InputError

LONGEST_GAP = 2.5  # [s]; waves of four seconds are no longer seen across it
_FEWEST = 10  # samples
_DEGREE = 5  # a spline with smooth accelerations


def replayed(
    t: np.ndarray,
    roll: np.ndarray,
    pitch: np.ndarray,
    yaw: np.ndarray,
    heave: np.ndarray | None,
    rate_hz: float,
    source: str,
) -> ShipMotion:
    """The motion of a log at an even rate [Hz], from 0 s on, by quintic splines through every sample.

    t: (n,) increasing [s]; roll, pitch, yaw: (n,) of R = Rz(yaw) Ry(pitch) Rx(roll) [rad]; heave: (n,) upwards [m], of
    the point where it was measured, or None: still. Yaw may jump by whole turns. Surge and sway, which no motion
    sensor gives, are still. `source` names the log in messages.
    Raises InputError for too few samples, values that are no numbers, time that runs backwards, and gaps.
    """
    still = np.zeros(len(t)) if heave is None else heave
    columns = np.column_stack([still, roll, pitch, np.unwrap(yaw)])
    _check(t, columns, source)
    spline = make_interp_spline(t - t[0], columns, k=_DEGREE)
    at = np.arange(int((t[-1] - t[0]) * rate_hz + 1e-6) + 1) / rate_hz
    value, rate, second = (spline(at, order) for order in range(3))

    def vertical(column: np.ndarray) -> np.ndarray:
        return np.stack([np.zeros_like(column), np.zeros_like(column), column], axis=-1)

    return ShipMotion(
        at,
        *(vertical(part[:, 0]) for part in (value, rate, second)),
        *(part[:, 1:] for part in (value, rate, second)),
    )


def _check(t: np.ndarray, columns: np.ndarray, source: str) -> None:
    if len(t) < _FEWEST:
        raise InputError(f"{source}: {len(t)} samples of motion; allowed are at least {_FEWEST}")
    bad = np.flatnonzero(~np.isfinite(np.column_stack([t, columns])).all(axis=1))
    if len(bad):
        raise InputError(f"{source}: sample {bad[0] + 1}: found a value that is no finite number")
    step = np.diff(t)
    if step.min() <= 0:
        row = step.argmin() + 1
        raise InputError(
            f"{source}: sample {row + 1}: time goes from {t[row - 1]:.6g} to {t[row]:.6g} s; it must increase"
        )
    if step.max() > LONGEST_GAP:
        row = step.argmax() + 1
        raise InputError(
            f"{source}: sample {row + 1}: nothing for {step.max():.3g} s after {t[row - 1] - t[0]:.6g} s; allowed are "
            f"gaps of {LONGEST_GAP:g} s, so cut the log there"
        )
