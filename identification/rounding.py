"""Measurements that were printed with fewer digits than the sensor has."""

from __future__ import annotations

import numpy as np
import pandas as pd

from kincal.identification.channels import named
from kincal.identification.measurements import Measurements

_FEWEST = 8  # rows: fewer may be round by chance
_DIGITS = 7  # more are no rounding
_UNITS = {"m": (1.0, 1e3), "rad": (1.0, 180 / np.pi), "1": (1.0,)}  # in which people print
_OF_TURN = 2.0  # a quaternion's component is half an angle


def rounding_finding(table: pd.DataFrame, measured: Measurements) -> str:
    """A sentence where a channel's numbers are coarser than its sigma; empty: none is.

    table: canonical, of which `measured` was made.
    """
    if len(table) < _FEWEST:
        return ""
    for channel in named(measured.channels):
        columns = table[list(channel.columns)].to_numpy(float)
        step = max((_step(columns * factor) / factor for factor in _UNITS[channel.column_unit]), default=0.0)
        step *= _OF_TURN if channel.column_unit == "1" else 1.0
        sigma = float(np.median(measured.std[channel.name]))
        if step / np.sqrt(12) > sigma:
            unit, factor = channel.human
            return (
                f"{', '.join(channel.columns)} are rounded to steps of {factor * step:.2g} {unit}, coarser than their "
                f"sigma of {factor * sigma:.2g} {unit}: write more digits"
            )
    return ""


def _step(values: np.ndarray) -> float:
    """The step of ten that all values are whole multiples of; 0: none of up to seven digits."""
    for digits in range(_DIGITS):
        scaled = values * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() < 1e-6:
            return float(10.0**-digits)
    return 0.0
