"""Two instruments on one body: the lag between their clocks, and what then differs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from kincal.identification.streams.columns import ANGLES
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import wrap

_LEAST = 10  # samples in common


@dataclass(frozen=True)
class Alignment:
    """first(t) = second(t + lag) + bias + what is left, of each angle that both have."""

    lag: float  # [s] what the second's clock is ahead
    bias: dict[str, float]  # [rad]
    std: dict[str, float]  # [rad]
    samples: int


def align(first: pd.DataFrame, second: pd.DataFrame, widest: float = 2.0) -> Alignment:
    """The lag within +-widest [s] that leaves the least scatter of roll and pitch, and the differences at it.

    The second stream is interpolated by cubic splines: at a few samples a wave, straight lines err more than the
    instruments do. Raises InputError where the streams have no time in common.
    """
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    channels = [c for c in ANGLES if c in first and c in second]
    t, of_second = first["t"].to_numpy(float), second["t"].to_numpy(float)
    inside = (t >= of_second[0] + widest) & (t <= of_second[-1] - widest)
    if inside.sum() < _LEAST:
        raise InputError(
            f"the streams have {inside.sum()} samples in common ({t[0]:.3f} to {t[-1]:.3f} s, {of_second[0]:.3f} to "
            f"{of_second[-1]:.3f} s); allowed are at least {_LEAST}"
        )
    t = t[inside]
    splines = {c: CubicSpline(of_second, np.unwrap(second[c].to_numpy(float))) for c in channels}
    angles = {c: first[c].to_numpy(float)[inside] for c in channels}

    def difference(channel: str, lag: float) -> np.ndarray:
        apart = wrap(angles[channel] - splines[channel](t + lag))
        return wrap(apart - apart[0]) + apart[0]  # on one side of +-180 degrees

    def scatter(lag: float) -> float:
        return float(sum(np.var(difference(c, lag)) for c in ("roll", "pitch")))

    coarse = np.linspace(-widest, widest, 41)
    start = coarse[np.argmin([scatter(lag) for lag in coarse])]
    step = coarse[1] - coarse[0]
    minimum: Any = minimize_scalar(scatter, bounds=(start - step, start + step), method="bounded")
    lag = float(minimum.x)
    left = {c: difference(c, lag) for c in channels}
    return Alignment(
        lag, {c: float(v.mean()) for c, v in left.items()}, {c: float(v.std()) for c, v in left.items()}, len(t)
    )
