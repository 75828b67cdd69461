"""The response of a ship known by her main dimensions alone.

Heave, pitch and roll: Jensen, Mansour & Olsen 2004, "Estimation of ship motions using closed-form expressions", Ocean
Engineering 31, 61-85. The paper gives amplitudes; phases follow from the same equations of motion, their terms taken
as complex numbers, with roll excited in phase with the waves' slope. Surge, sway and yaw are not in the paper: the
hull moves with the water that it displaces (mean orbital motion, and its mean turn, over a box L x B x T).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from kincal.pipeline.sea.settings import Vessel

_AFT = 0.6  # delta, the share of the length at full beam in the two-beam hull of roll
_SMALL = 1e-9


@dataclass(frozen=True)
class ClosedFormRao:
    """`Rao` of a vessel, for any frequency, direction and speed."""

    vessel: Vessel

    def response(self, frequency: np.ndarray, direction: np.ndarray, speed: float) -> np.ndarray:
        w, beta = np.broadcast_arrays(np.asarray(frequency, dtype=float), direction)
        along, across = np.cos(beta), np.sin(beta)
        encounter = w - w**2 * speed * along / g
        encounter = np.where(np.abs(encounter) < _SMALL, _SMALL, encounter)
        k = w**2 / g
        heave, pitch = _heave_pitch(self.vessel, k, along, encounter / w)
        surge, sway, yaw = _with_the_water(self.vessel, k, along, across)
        return np.stack([surge, sway, heave, _roll(self.vessel, k, along, across, encounter), pitch, yaw], axis=-1)


def _heave_pitch(vessel: Vessel, k: np.ndarray, along: np.ndarray, alpha: np.ndarray):
    """Jensen et al.: a box in strip theory, beam times block coefficient; alpha = w_e / w. Pitch is bow down here."""
    length, beam, draught = vessel.length_m, vessel.beam_m * vessel.block_coefficient, vessel.draught_m
    half = np.abs(k * along) * length / 2
    radiated = 2 * np.sin(k * beam * alpha**2 / 2) * np.exp(-k * draught * alpha**2)
    damping = radiated**2 / (k * beam * alpha**2)
    side = np.sign(alpha)  # damping takes energy also where the ship overtakes the waves
    force = np.exp(-np.abs(k * along) * draught) * (1 - k * draught + 1j * side * damping / np.abs(alpha))
    dynamic = 1 - 2 * k * draught * alpha**2 + 1j * side * damping
    return force * _mean(half) / dynamic, 1j * k * along * force * _slope(half) / dynamic


def _roll(vessel: Vessel, k: np.ndarray, along: np.ndarray, across: np.ndarray, encounter: np.ndarray) -> np.ndarray:
    """Jensen et al.: two prismatic beams; the moment follows from their damping by Haskind's relation.

    Density cancels out: moments are divided by it.
    """
    length, beam, draught = vessel.length_m, vessel.beam_m, vessel.draught_m
    ratio = max((vessel.waterplane_coefficient - _AFT) / (1 - _AFT), draught / beam)  # of the beams' breadths
    area = vessel.block_coefficient * beam * draught / (_AFT + ratio * (1 - _AFT))
    aft = _sectional_damping(area, beam, draught, np.abs(encounter))
    fore = _sectional_damping(ratio * area, ratio * beam, draught, np.abs(encounter))
    phase = np.abs(k * along) * length / 2
    aft_part = _AFT * _mean(_AFT * phase) * np.sqrt(aft)
    fore_part = (1 - _AFT) * _mean((1 - _AFT) * phase) * np.sqrt(fore)
    moment = g * length * np.abs(aft_part + np.exp(1j * phase) * fore_part) / np.sqrt(np.abs(encounter))
    stiffness = g * vessel.block_coefficient * length * beam * draught * vessel.metacentric_height
    period = vessel.roll_period
    damping = length * (_AFT * aft + (1 - _AFT) * fore) + vessel.roll_damping * stiffness * period / np.pi
    dynamic = stiffness * (1 - (encounter * period / (2 * np.pi)) ** 2) + 1j * encounter * damping
    return -1j * across * moment / dynamic


def _sectional_damping(area: float, beam: float, draught: float, frequency: np.ndarray) -> np.ndarray:
    """b44 / density of a section, their fit for 1 <= B/T <= 6; frequencies in units of sqrt(2 g / B)."""
    slender = min(max(beam / draught, 1.0), 6.0)
    if slender >= 3:
        a, b, d = 0.256 * slender - 0.286, -0.11 * slender - 2.55, 0.033 * slender - 1.419
    else:
        a, b, d = -3.94 * slender + 13.69, -2.12 * slender - 1.89, 1.16 * slender - 7.97
    unit = np.sqrt(2 * g / beam)
    w = np.maximum(frequency / unit, 0.05)  # below, the fit is zero but for rounding
    return area * beam**2 * unit * a * np.exp(b * w**-1.3) * w**d


def _with_the_water(vessel: Vessel, k: np.ndarray, along: np.ndarray, across: np.ndarray):
    """Surge, sway and yaw: orbital motion -i exp(k z - i k x) towards the waves' direction, meaned over the box."""
    half = np.abs(k * along) * vessel.length_m / 2
    depth = -np.expm1(-k * vessel.draught_m) / (k * vessel.draught_m) * _mean(k * across * vessel.beam_m / 2)
    orbit = -1j * depth * _mean(half)
    return along * orbit, across * orbit, -k * along * across * depth * _slope(half)


def _mean(x: np.ndarray) -> np.ndarray:
    """Mean of cos over [-x, x]."""
    return np.sinc(np.asarray(x) / np.pi)


def _slope(x: np.ndarray) -> np.ndarray:
    """Slope of the straight line that fits sin over [-x, x] best: 3 (sin x - x cos x) / x^3."""
    safe = np.where(x < 1e-3, 1.0, x)
    return np.where(x < 1e-3, 1 - x**2 / 10, 3 * (np.sin(safe) - safe * np.cos(safe)) / safe**3)
