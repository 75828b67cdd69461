"""Angles in degrees."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake, of_values


def degrees(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Of every channel whose columns are angles."""
    for channel in named(measured.channels):
        if channel.column_unit == "rad":
            yield of_values(f"{channel.name} is in degrees, not radians", channel, partial(np.multiply, np.pi / 180))
