"""Whether a drift along the rows of a table is a likely cause of residuals that the parameters do not explain.

Each actuator's zero, and each coordinate of the instrument's frame W, may drift linearly from the first pose to the
last. The fall of chi-square that such drifts bring, the parameters refitted beside them, is tested for significance
(F test) and for size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, stdtrit

from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements

_CHANCE = 1e-6  # that poses without a drift show one
_EXPLAINED = 0.5  # share of chi-square that a likely cause takes away
_AT_ONCE = 2000  # poses
_SHOWN = 1e-3  # that a drift which is named is chance


@dataclass(frozen=True)
class _Drift:
    """Linear drifts of some parameters."""

    where: str
    columns: np.ndarray  # of the parameters
    size: np.ndarray  # from the first pose to the last [m, rad]
    error: np.ndarray  # one sigma of it, by the residuals that are left
    fall: float  # of chi-square
    chi_square: float  # what is left
    freedom: float

    @property
    def significant(self) -> bool:
        k = len(self.columns)
        ratio = (self.fall / k) / max(self.chi_square / self.freedom, 1e-300)
        return bool(fdtrc(k, self.freedom, ratio) < _CHANCE)

    def named(self, model: ErrorModel) -> str:
        """The drifts that are no chance, the largest first."""
        limit = float(stdtrit(self.freedom, 1 - _SHOWN / len(self.columns)))
        ratio = np.abs(self.size) / self.error
        parts = []
        for k in np.argsort(-ratio):
            if ratio[k] > limit or not parts:
                unit, factor = HUMAN[model.parameters.units[self.columns[k]]]
                name = model.parameters.names[self.columns[k]].removesuffix(".zero")
                parts.append(f"{name} {factor * self.size[k]:+.3g} {unit}")
        return f"{self.where} ({', '.join(parts)} from the first pose to the last)"


def drift_finding(
    model: ErrorModel, measured: Measurements, estimate: Estimate, chi_square: float, freedom: float
) -> str | None:
    """A sentence where a drift along the rows explains most of chi-square; else None. Rows are in the order of time."""
    index = np.arange(len(model.parameters))
    zeros = index[model.zeros]
    candidates = [("a drift of one actuator along the rows", np.array([zero])) for zero in zeros]
    candidates += [
        ("a drift of the actuators along the rows", zeros),
        ("a drift of the instrument along the rows", index[-12:-6]),
    ]
    drifts = [_drift(model, measured, estimate, *c, chi_square, freedom) for c in candidates]
    likely = [d for d in drifts if d is not None and d.significant and d.fall > _EXPLAINED * chi_square]
    if not likely:
        return None
    best = min(d.chi_square for d in likely)
    causes = [d for d in likely if d.chi_square < best + max(best, freedom)]  # beyond, the other is far likelier
    if any(len(d.columns) == 1 for d in causes):  # of drifts that explain as much, those of one actuator alone
        causes = [d for d in causes if not np.isin(zeros, d.columns).all() or len(zeros) == 1]
    drifts = ", or ".join(drift.named(model) for drift in causes)
    return f"likely cause: {drifts}; 95 % regions do not know of it, and can't be trusted"


def _drift(
    model: ErrorModel,
    measured: Measurements,
    estimate: Estimate,
    where: str,
    columns: np.ndarray,
    chi_square: float,
    freedom: float,
) -> _Drift | None:
    k, n = len(columns), len(model.parameters)
    if freedom - k < 1:
        return None
    square, mixed, slope = np.zeros((k, k)), np.zeros((k, n)), np.zeros(k)
    for rows, jacobian, time in _parts(model, measured, estimate):
        by_drift = jacobian[:, :, columns] * time[:, None, None]
        flat = by_drift.reshape(-1, k)
        square += flat.T @ flat
        mixed += flat.T @ jacobian.reshape(-1, n)
        slope += flat.T @ estimate.residual[rows].ravel()
    # the parameters move along: what is left of the drifts' information (Schur complement)
    left = square - mixed @ estimate.leverage @ mixed.T
    values, vectors = np.linalg.eigh(left)
    known = values > 1e-9 * max(float(np.trace(square)), 1e-300)
    if not known.any():
        return None
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    size, fall = -inverse @ slope, float(slope @ inverse @ slope)
    rest, freedom = max(chi_square - fall, 0.0), freedom - int(known.sum())
    error = np.sqrt(np.maximum(np.diag(inverse) * max(rest / freedom, 1e-300), 1e-300))
    return _Drift(where, columns, size, error, fall, rest, freedom)


def _parts(model: ErrorModel, measured: Measurements, estimate: Estimate) -> Iterator[tuple]:
    """(rows, whitened Jacobian there, time from -1/2 to 1/2), some poses at a time."""
    time = np.linspace(-0.5, 0.5, len(measured))
    for first in range(0, len(measured), _AT_ONCE):
        rows = slice(first, first + _AT_ONCE)
        part = measured[np.arange(len(measured))[rows]]
        yield rows, model.jacobian(estimate.p, part, estimate.q[rows]), time[rows]
