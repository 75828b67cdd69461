"""Wave-band models: what a target in a seaway does, as linear systems driven by white noise.

Horizontal acceleration is the second derivative of a displacement that stays bounded: below the waves its spectrum
falls with the fourth power of frequency, and that is what tells tilt from acceleration. Displacement x, per axis:

    (d2/dt2 + 2 z w d/dt + w^2)^3 x = white noise,    state (x, dx, .., d5x)

Three equal oscillators in a row, because a ship smooths short waves: the spectrum of acceleration falls with the eighth
power on the other side. With fewer, what is not there at the top would be made up for by too narrow a band. Angles of
a target without a gyro are one oscillator, state (p, dp). After Fossen, Handbook of Marine Craft Hydrodynamics and
Motion Control (2nd ed., 2021), section 10.2 (linear wave response models).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

ACCELERATION = 2  # its place in the state of a displacement
_OSCILLATORS = 3
ORDER = 2 * _OSCILLATORS  # states an axis


@dataclass(frozen=True)
class Discrete:
    """x[k+1] = transition x[k] + noise; matrices (m, m), stationary covariance (m, m)."""

    transition: np.ndarray
    noise: np.ndarray
    stationary: np.ndarray


def displacement(period: float, acceleration: float, damping: float, dt: float) -> Discrete:
    """Of one horizontal axis over dt [s]: waves of `period` [s], `acceleration` one sigma [m/s2]."""
    w = 2 * np.pi / period
    unit = _unit(w * dt, damping, _OSCILLATORS)
    scale = (
        w ** np.arange(-ACCELERATION, float(ORDER - ACCELERATION))
        * acceleration
        / np.sqrt(unit.stationary[ACCELERATION, ACCELERATION])
    )
    return _scaled(unit, scale)


def angle(period: float, sigma: float, damping: float, dt: float) -> Discrete:
    """Of one angle without a gyro: (angle about its mean [rad], rate [rad/s]), `sigma` of the angle [rad]."""
    w = 2 * np.pi / period
    unit = _unit(w * dt, damping, 1)
    return _scaled(unit, w ** np.arange(0, 2.0) * sigma / np.sqrt(unit.stationary[0, 0]))


def acceleration_by_velocity(damping: float) -> float:
    """sigma(d2x) / sigma(dx) of `displacement` in units of 2 pi / period."""
    p = _unit(1.0, damping, _OSCILLATORS).stationary
    return float(np.sqrt(p[2, 2] / p[1, 1]))


@lru_cache(maxsize=4096)
def _unit(dt: float, damping: float, oscillators: int) -> Discrete:
    """`oscillators` in a row at 1 rad/s, driven by unit noise."""
    polynomial = np.array([1.0])
    for _ in range(oscillators):
        polynomial = np.convolve(polynomial, [1.0, 2 * damping, 1.0])
    m = 2 * oscillators
    a = np.diag(np.ones(m - 1), 1)
    a[-1] = -polynomial[:0:-1]
    drive = np.zeros((m, m))
    drive[-1, -1] = 1.0
    # Van Loan 1978: one exponential gives the transition and the noise it gathers
    block = expm(np.block([[-a, drive], [np.zeros((m, m)), a.T]]) * dt)
    transition = block[m:, m:].T
    noise = transition @ block[:m, m:]
    return Discrete(transition, (noise + noise.T) / 2, solve_continuous_lyapunov(a, -drive))


def _scaled(unit: Discrete, scale: np.ndarray) -> Discrete:
    both = np.outer(scale, scale)
    return Discrete(unit.transition * np.outer(scale, 1 / scale), unit.noise * both, unit.stationary * both)
