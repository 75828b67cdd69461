"""The waves: a JONSWAP sea, and a realisation of it as a sum of harmonic waves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import g
from scipy.integrate import cumulative_trapezoid

from kincal.pipeline.sea.settings import Seaway

COMPONENTS = 1000  # harmonic waves in a record
_LOW, _HIGH = 0.5, 6.0  # of the peak frequency: outside is a thousandth of the energy
_GRID = 1500


@dataclass(frozen=True)
class Waves:
    """Harmonic waves, n of them: elevation at the ship is the sum of amplitude cos(encounter t + phase).

    frequency: (n,) [rad/s]; encounter: (n,) that of encounter, negative where the ship overtakes a wave [rad/s];
    direction: (n,) [rad]; amplitude: (n,) [m]; phase: (n,) [rad].
    """

    frequency: np.ndarray
    encounter: np.ndarray
    direction: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray


def spectrum(sea: Seaway) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) [rad/s] and the JONSWAP density (n,) [m^2 s / rad] there."""
    from waveresponse import JONSWAP

    frequency = np.linspace(_LOW, _HIGH, _GRID) * 2 * np.pi / sea.peak_period
    return frequency, JONSWAP(frequency)(sea.significant_height, sea.peak_period, gamma=sea.peak_enhancement)[1]


def drawn(sea: Seaway) -> Waves:
    """A realisation of the sea, by its seed.

    The band is cut into bins that hold equal shares of bandwidth and energy, half and half; each has one wave of a
    random frequency, so that a record does not repeat, of amplitude sqrt(2 S dw), so that its variance is that of the
    spectrum. Each wave of a spread sea has one direction: equally likely ones, shuffled over the frequencies.
    """
    random = np.random.default_rng([sea.seed, 6])
    grid, density = spectrum(sea)
    energy = cumulative_trapezoid(density, grid, initial=0)
    share = (energy / energy[-1] + (grid - grid[0]) / (grid[-1] - grid[0])) / 2
    edges = np.interp(np.linspace(0, 1, COMPONENTS + 1), share, grid)
    frequency = edges[:-1] + random.random(COMPONENTS) * np.diff(edges)
    amplitude = np.sqrt(2 * np.interp(frequency, grid, density) * np.diff(edges))
    direction = np.full(COMPONENTS, sea.heading)
    if sea.spreading is not None:
        direction += random.permutation(_spread(sea.spreading, (np.arange(COMPONENTS) + 0.5) / COMPONENTS))
    encounter = frequency - frequency**2 * sea.speed * np.cos(direction) / g
    return Waves(frequency, encounter, direction, amplitude, random.uniform(0, 2 * np.pi, COMPONENTS))


def _spread(s: int, share: np.ndarray) -> np.ndarray:
    """Angles from the main direction [rad] with a share (n,) of the energy below them."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 1001)
    total = cumulative_trapezoid(spreading(s, angle), angle, initial=0)
    return np.interp(share, total / total[-1], angle)


def spreading(s: int, angle: np.ndarray) -> np.ndarray:
    """Density [1/rad] of the energy over angles (n,) [rad] from the main direction: cos^2s within +-90 degrees."""
    from waveresponse import CosineHalfSpreading

    density = CosineHalfSpreading(s)
    return np.array([density(1.0, float(a)) for a in angle])  # the same at every frequency
