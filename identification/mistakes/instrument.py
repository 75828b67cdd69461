"""The instrument's scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.refit import refitted
from kincal.urdf.rigid_motion import exp, log

_SMALL = 1e-5  # of a difference of the scale
_MOST = 0.2  # more is a unit


def instrument_scale(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One channel that reads too much, or too little, by a constant factor."""
    for channel in measured.channels:
        cause = f"the instrument's scale of {channel} is wrong"
        yield Mistake(cause, lambda m, c=channel: refitted(model, m, lambda x: _scaled(m, c, 1 + x), _SMALL, _MOST))


def _scaled(m: Measurements, channel: str, factor: float) -> Measurements:
    values = m.values[channel]
    if channel == "orientation":  # its rotation vector from the first pose
        return m.replaced(orientation=values[0] @ exp(factor * log(values[0].T @ values)))
    centre = np.mean(values, axis=0)
    return m.replaced(**{channel: centre + factor * (values - centre)})
