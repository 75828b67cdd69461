"""Robust loss: what one pose's reading of one sensor may cost, by the length of its whitened residual.

Blocks are a pose's rows of one channel (three of an orientation): an instrument errs as a whole. Scaled so that on
Gaussian noise the loss curves like the sum of squares: it balances priors as least squares does. The tuning
constants leave 95 % of the efficiency of least squares on Gaussian noise (Huber 1981, Robust Statistics).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri, gamma

from kincal.identification.channels import named

_EFFICIENCY = 0.95
_ORDINARY = 1e-4  # a good reading is longer with this probability: beyond, its own curvature counts


@dataclass(frozen=True)
class Loss:
    """kind: gaussian (the sum of squares), huber, or cauchy."""

    kind: str = "gaussian"

    def cost(self, residual: np.ndarray, channels: tuple[str, ...]) -> float:
        """Half the sum of squares, or what stands for it; residual: (n, rows a pose), whitened."""
        if self.kind == "gaussian":
            return 0.5 * float(np.sum(residual**2))
        total = 0.0
        for rows, d in blocks(channels):
            length, (c, curvature, _) = np.linalg.norm(residual[:, rows], axis=1), _tuned(self.kind, d)
            total += float(np.sum(_rho(self.kind, length, c))) / curvature
        return total

    def weights(self, residual: np.ndarray, channels: tuple[str, ...]) -> np.ndarray:
        """(n, rows a pose): of each squared residual, in iteratively reweighted least squares."""
        weights = np.ones_like(residual)
        for rows, d in blocks(channels) if self.kind != "gaussian" else ():
            length, (c, curvature, _) = np.linalg.norm(residual[:, rows], axis=1), _tuned(self.kind, d)
            weights[:, rows] = (_weight(self.kind, length, c) / curvature)[:, None]
        return weights

    def information(self, residual: np.ndarray, channels: tuple[str, ...]) -> np.ndarray:
        """(n, rows a pose): what each row tells, as a share of what it tells least squares on Gaussian noise.

        (mean slope)^2 / mean square of the influence: that of Gaussian noise for ordinary readings, its own for others.
        """
        shares = np.ones_like(residual)
        for rows, d in blocks(channels) if self.kind != "gaussian" else ():
            length, (c, _, efficiency) = np.linalg.norm(residual[:, rows], axis=1), _tuned(self.kind, d)
            slope = np.maximum(_slope(self.kind, length, c, d), 0.0)
            square = _weight(self.kind, length, c) ** 2 * length**2 / d
            ordinary = length**2 <= chdtri(d, _ORDINARY)
            shares[:, rows] = np.where(ordinary, efficiency, slope**2 / np.maximum(square, 1e-300))[:, None]
        return shares


def blocks(channels: tuple[str, ...]) -> Iterator[tuple[slice, int]]:
    """Each channel's rows of a pose, and how many."""
    row = 0
    for channel in named(channels):
        yield slice(row, row + channel.rows), channel.rows
        row += channel.rows


def _rho(kind: str, length: np.ndarray, c: float) -> np.ndarray:
    if kind == "huber":
        return np.where(length <= c, 0.5 * length**2, c * length - 0.5 * c**2)
    return 0.5 * c**2 * np.log1p((length / c) ** 2)


def _weight(kind: str, length: np.ndarray, c: float) -> np.ndarray:
    if kind == "huber":
        return np.minimum(1.0, c / np.maximum(length, 1e-300))
    return 1 / (1 + (length / c) ** 2)


def _slope(kind: str, length: np.ndarray, c: float, d: int) -> np.ndarray:
    """The mean derivative of the influence weight * u over the d directions of u."""
    if kind == "huber":
        return np.where(length <= c, 1.0, c / np.maximum(length, 1e-300) * (1 - 1 / d))
    weight = _weight(kind, length, c)
    return weight - 2 * (length / c) ** 2 * weight**2 / d


@lru_cache
def _tuned(kind: str, d: int) -> tuple[float, float, float]:
    """The constant c, and on Gaussian noise of d dimensions the mean slope and the efficiency."""
    from scipy.optimize import brentq

    length = np.linspace(0, 12, 6001)
    density = length ** (d - 1) * np.exp(-0.5 * length**2) / (2 ** (d / 2 - 1) * gamma(d / 2))

    def mean(values: np.ndarray) -> float:
        return float(np.trapezoid(values * density, length))

    def at(c: float) -> tuple[float, float]:
        slope = mean(_weight(kind, length, c) * length**2) / d  # the mean slope, by Stein's identity: no step at c
        return slope, slope**2 / mean(_weight(kind, length, c) ** 2 * length**2 / d)

    c = float(brentq(lambda c: at(c)[1] - _EFFICIENCY, 0.5, 20.0))  # pyright: ignore[reportArgumentType]
    return c, *at(c)
