"""The settings of a ship in a seaway."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.constants import knot

from kincal.urdf.description import File, Positive

# Significant wave height [m] (mean of the range) and most probable peak period [s] of the open North Atlantic: NATO's
# STANAG 4194, after Bales, Lee & Voelker 1981 (DTNSRDC/SPD-0919-01). The ranges are those of the WMO's code 3700.
SEA_STATES = {3: (0.88, 7.5), 4: (1.88, 8.8), 5: (3.25, 9.7), 6: (5.0, 12.4)}

Fraction = Annotated[float, Field(gt=0, le=1)]


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Vessel(Table):
    """A ship by her main dimensions; the default is a supply ship of 6400 t."""

    length_m: Positive = 82.8
    beam_m: Positive = 19.2
    draught_m: Positive = 6.0
    block_coefficient: Fraction = 0.65
    waterplane_coefficient: Fraction = 0.85
    metacentric_height_m: Positive | None = None  # transverse; default: 0.11 of the beam
    roll_period_s: Positive | None = None  # default: as the 2008 IS Code estimates it
    roll_damping: Annotated[float, Field(ge=0, lt=1)] = 0.2  # viscous, of critical; what waves carry off adds to it

    @model_validator(mode="after")
    def _ship(self) -> Vessel:
        if not 1 <= self.beam_m / self.draught_m <= 6:
            raise ValueError(f"beam_m / draught_m = {self.beam_m / self.draught_m:.3g}: allowed is 1 to 6")
        if self.length_m < 2 * self.beam_m:
            raise ValueError(f"length_m = {self.length_m:g}: allowed is at least twice beam_m")
        if self.waterplane_coefficient < self.block_coefficient:
            raise ValueError("waterplane_coefficient: allowed is at least block_coefficient")
        return self

    @property
    def metacentric_height(self) -> float:
        """[m]"""
        return self.metacentric_height_m or 0.11 * self.beam_m

    @property
    def roll_period(self) -> float:
        """[s]; 2008 IS Code, part A, 2.3.4: T = 2 C B / sqrt(GM)."""
        c = 0.373 + 0.023 * self.beam_m / self.draught_m - 0.043 * self.length_m / 100
        return self.roll_period_s or 2 * c * self.beam_m / math.sqrt(self.metacentric_height)


class Seaway(Table):
    """What moves the ship: sea, course and speed, and the ship herself."""

    sea_state: Literal[3, 4, 5, 6] = 5
    significant_height_m: Positive | None = None  # default: the sea state's
    peak_period_s: Positive | None = None  # default: the sea state's
    peak_enhancement: Annotated[float, Field(ge=1, le=7)] = 3.3  # JONSWAP's gamma
    spreading: Annotated[int, Field(ge=1, le=50)] | None = None  # s of cos^2s within +-90 degrees; None: long-crested
    heading_deg: float = 120.0  # where waves travel to, from the bow towards port: 0 following, 180 head sea
    speed_knots: Annotated[float, Field(ge=0, le=60)] = 0.0
    minutes: Annotated[float, Field(ge=0.1, le=24 * 60)] = 10.0
    rate_hz: Annotated[float, Field(ge=1, le=1000)] = 100.0
    vessel: Vessel = Vessel()
    rao: File | None = None  # a table of response amplitude operators in place of the closed forms
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0

    @property
    def significant_height(self) -> float:
        """[m]"""
        return self.significant_height_m or SEA_STATES[self.sea_state][0]

    @property
    def peak_period(self) -> float:
        """[s]"""
        return self.peak_period_s or SEA_STATES[self.sea_state][1]

    @property
    def heading(self) -> float:
        """[rad]"""
        return math.radians(self.heading_deg)

    @property
    def speed(self) -> float:
        """[m/s]"""
        return self.speed_knots * knot
