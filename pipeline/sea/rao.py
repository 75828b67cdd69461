"""Response amplitude operators: what a wave of one metre does to the ship.

A response H is complex: where the waves' elevation at the ship's origin is Re a exp(i w_e t), with the frequency of
encounter w_e = w - w^2 U cos(direction) / g, which is negative where the ship overtakes the waves, the motion is
Re H a exp(i w_e t). Surge, sway, heave in metres a metre, roll, pitch, yaw in radians a metre.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import RegularGridInterpolator

MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


class Rao(Protocol):
    def response(self, frequency: np.ndarray, direction: np.ndarray, speed: float) -> np.ndarray:
        """(..., 6) complex, of waves of frequency (...) [rad/s] towards direction (...) [rad] at a speed [m/s].

        Raises InputError for a speed that is not known.
        """
        ...


@dataclass(frozen=True)
class RaoTable:
    """Tabulated responses, at one speed; they are taken for other speeds as well, at the frequency of encounter.

    frequency: (f,) of the waves, increasing [rad/s]; direction: (d,) increasing, within [0, 2 pi) [rad];
    values: (f, d, 6) complex.
    """

    frequency: np.ndarray
    direction: np.ndarray
    values: np.ndarray

    def response(self, frequency: np.ndarray, direction: np.ndarray, speed: float) -> np.ndarray:
        """Squared amplitudes are interpolated linearly, as waveresponse does, phases as those of the complex values.

        Outside the table's frequencies the ship does not move.
        """
        at = np.stack(np.broadcast_arrays(frequency, np.mod(direction, 2 * np.pi)), axis=-1)
        phase = np.exp(1j * np.angle(self._phasors(at)))
        return (np.sqrt(self._squares(at)) * phase).reshape(*at.shape[:-1], len(MODES))

    @cached_property
    def _squares(self) -> RegularGridInterpolator:
        return self._interpolator(np.abs(self.values) ** 2)

    @cached_property
    def _phasors(self) -> RegularGridInterpolator:
        return self._interpolator(self.values)

    def _interpolator(self, values: np.ndarray) -> RegularGridInterpolator:
        turn = 2 * np.pi
        direction = np.concatenate([self.direction[-1:] - turn, self.direction, self.direction[:1] + turn])
        around = np.concatenate([values[:, -1:], values, values[:, :1]], axis=1)
        return RegularGridInterpolator((self.frequency, direction), around, bounds_error=False, fill_value=0.0)
