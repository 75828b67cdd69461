"""The non-geometric errors of a virtual robot, each a closed form.

Its actuated joints are shifted, in metres where they are prismatic and in radians where they are revolute. That its
instrument's axes leak into each other is in `identification.channels.instrument`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.urdf.description import VirtualErrors

_STILL = 1e-9  # m or rad: a smaller motion is rounding, and turns no gear
_NO_LOAD = 1e-9  # N or N m: what is smaller is rounding, and closes no gap


@dataclass(frozen=True)
class Circumstances:
    """What an actuator's shift depends on beside the reading of that pose."""

    approach: np.ndarray  # (n, n_actuated) sign of the actuator's last motion: -1, 1, or 0 before it ever moved
    warmth: np.ndarray  # (n,) 0: as at the first measured pose, 1: as at the last


def warming_up(n: int) -> np.ndarray:
    """(n,) warmth at poses that are measured one after the other, at equal distances in time."""
    return np.linspace(0.0, 1.0, n)


def approaches(joints: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(n, n_actuated) signs of the last motions on the way from `start` (n_actuated,) through joints (n, n_actuated).

    An actuator that rests keeps the sign of the motion that brought it there.
    """
    motion = np.diff(joints, axis=0, prepend=start[None])
    moved = np.abs(motion) > _STILL
    last = np.maximum.accumulate(np.where(moved, np.arange(len(joints))[:, None], 0), axis=0)
    return np.take_along_axis(np.where(moved, np.sign(motion), 0.0), last, axis=0)


def screw(
    errors: VirtualErrors, sliding: np.ndarray, joints: np.ndarray, home: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Of a screw, or a gear: amplitude sin(2 pi q / period + phase) + quadratic (q - home)^2, at joints (n, k)."""
    amplitude = _each(sliding, errors.screw_amplitude_mm, errors.gear_amplitude_deg)
    period = _each(sliding, errors.screw_period_mm, errors.gear_period_deg)
    quadratic = np.where(sliding, errors.screw_quadratic_per_m, errors.gear_quadratic_per_rad)
    return amplitude * np.sin(2 * np.pi * joints / period + phase) + quadratic * (joints - home) ** 2


def backlash(errors: VirtualErrors, sliding: np.ndarray, approach: np.ndarray) -> np.ndarray:
    """(n, k): the joint lags behind its motor by half the backlash; approach: (n, k) signs of the last motions."""
    return -0.5 * _each(sliding, errors.backlash_mm, errors.backlash_deg) * approach


def thermal_growth(errors: VirtualErrors, sliding: np.ndarray, sign: np.ndarray, warmth: np.ndarray) -> np.ndarray:
    """(n, k): linear in the warmth (n,); sign: (k,) of each actuator."""
    return warmth[:, None] * sign * _each(sliding, errors.thermal_growth_mm, errors.thermal_growth_deg)


def clearance(errors: VirtualErrors, sliding: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(n, k): the load (n, k) [N, N m] pushes the joint to one end of its play."""
    direction = np.where(np.abs(load) > _NO_LOAD, np.sign(load), 0.0)
    return 0.5 * _each(sliding, errors.clearance_mm, errors.clearance_deg) * direction


def deflection(errors: VirtualErrors, sliding: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(n, k): the actuator gives way to the load (n, k) [N, N m] in proportion."""
    return load / np.where(sliding, errors.stiffness_n_per_m, errors.stiffness_nm_per_rad)


def _each(sliding: np.ndarray, mm: float, deg: float) -> np.ndarray:
    """(k,): millimetres where the actuator is prismatic, degrees where it is revolute, as [m] and [rad]."""
    return np.where(sliding, mm * 1e-3, np.deg2rad(deg))
