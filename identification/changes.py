"""What changed between two identifications of one robot, in sigmas of the change.

Both estimates p1, p2 are drawn towards the same drawing by the same tolerances P, so their errors are not independent.
With covariances C1 and C2 of maximum a posteriori estimates, of a robot that did not change,

    covariance(p2 - p1) = V = C1 + C2 - C1 P^-1 C2 - C2 P^-1 C1

(P^-1 = 0 for W and T, and for estimators without priors). A change of one true parameter shows in all estimates that it
cannot be told apart from: p2 - p1 is on average the parameter's column of I - C2 P^-1 times the change. Each parameter
is tried alone, by least squares weighted with V. Where residuals are larger than the sensors' sigmas, C is enlarged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

from kincal.identification.identification import Identification

_FRAMES = 12  # W and T come last: an instrument that was set up anew is no change of the robot
_KNOWN = 1e-9  # of the largest variance, in tolerances: what is less is rounding
_SURE = 0.01  # that any of a robot's parameters is said to have changed by chance
_SEEN = 100.0  # tolerances of one sigma: beyond, the measurements do not see a change
_ALIKE = 0.02  # share by which explanations as good as the best one may differ in sigmas


@dataclass(frozen=True)
class Changes:
    """From a first to a second identification; parameters of the geometry and the actuators, without W and T."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    change: np.ndarray  # (n,) of this parameter, if it alone changed [m, rad, 1]
    std: np.ndarray  # (n,) one sigma of it; infinite where the measurements do not see it
    chi_square: float  # of all differences
    freedom: int

    @property
    def sigmas(self) -> np.ndarray:
        """(n,) changes in their sigmas."""
        return self.change / self.std

    @property
    def p_value(self) -> float:
        """The probability that a robot which did not change shows as much."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def limit(self) -> float:
        """Sigmas beyond which a parameter's change is no chance, the number of parameters counted."""
        return float(-ndtri(_SURE / (2 * max(len(self.names), 1))))

    @property
    def likely(self) -> list[int]:
        """The parameters whose change alone explains the differences best; several where they do it alike."""
        sizes = np.abs(self.sigmas)
        best = float(sizes.max(initial=0.0))
        return [int(k) for k in np.argsort(-sizes, kind="stable") if sizes[k] > max((1 - _ALIKE) * best, self.limit)]


def same_drawing(first: Identification, second: Identification) -> bool:
    """Whether both are identifications of one design: the same parameters with the same nominal values."""
    return first.names == second.names and np.allclose(first.nominal, second.nominal, rtol=1e-9, atol=1e-9)


def changes(first: Identification, second: Identification) -> Changes:
    """Of two identifications with the `same_drawing`."""
    (one, by_prior), (other, by_prior_too) = (_enlarged(i) for i in (first, second))
    covariance = one + other - (one * by_prior) @ other - (other * by_prior_too) @ one
    rows = np.arange(len(first.names) - _FRAMES)
    scale = first.tolerance[rows]
    shows = (np.eye(len(first.names)) - other * by_prior_too)[np.ix_(rows, rows)] / scale[:, None]
    values, vectors = np.linalg.eigh(covariance[np.ix_(rows, rows)] / np.outer(scale, scale))
    known = values > _KNOWN * max(float(values.max(initial=0.0)), 1e-300)
    whitener = vectors[:, known].T / np.sqrt(values[known])[:, None]
    difference, columns = whitener @ ((second.change - first.change)[rows] / scale), whitener @ shows
    information = np.sum(columns**2, axis=0)
    seen = information * scale**2 > 1.0 / _SEEN**2
    change = np.where(seen, columns.T @ difference / np.maximum(information, 1e-300), 0.0)
    std = np.where(seen, 1 / np.sqrt(np.maximum(information, 1e-300)), np.inf)
    chi_square, freedom = float(np.sum(difference**2)), int(known.sum())
    return Changes(first.names[: len(rows)], first.units[: len(rows)], change, std, chi_square, freedom)


def _enlarged(identification: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Its covariance, and the diagonal (n,) of P^-1; both by how much the residuals are larger than the sensors'."""
    ratio = max(identification.chi_square / max(identification.degrees_of_freedom, 1.0), 1.0)
    n = len(identification.names)
    by_map = identification.estimator == "map"
    inverse = 1 / (identification.shrinkage * identification.tolerance) ** 2 if by_map else np.zeros(n)
    return identification.covariance * ratio, inverse / ratio
