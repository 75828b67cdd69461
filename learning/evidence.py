"""Bayesian linear regression by evidence: errors e = r + A b, b normal, the priors' widths found from the data.

MacKay 1992, "Bayesian interpolation", Neural Computation 4: every group of columns has one precision, which with the
noise maximises the probability of the data. Group 0 has the unit prior that it came with: the geometry's tolerances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri  # pyright: ignore[reportAttributeAccessIssue]
from scipy.special import chdtri

from kincal.learning.correction import HELD, variance

_ITERATIONS = 60
_SETTLED = 1e-2  # of the logarithm of a precision: predictions change by a millionth
_PRECISIONS = (1e-6, 1e9)  # beyond: the group is as good as free, or gone
_START = 0.1
_LEAST_NOISE = 1e-6  # of a row
_GONE = 0.05  # of a column, determined by the data: the group is not needed
_FEW = 0.8  # the same with too few poses to see the 95 % by
_ENOUGH = 40  # poses
_INFLATION = (0.1, 1e4)  # of a covariance


@dataclass(frozen=True)
class Rows:
    """Linear errors of n measured poses, m rows each, whitened by the instruments' sigmas."""

    error: np.ndarray  # (n, m) r
    columns: np.ndarray  # (n, m, K) A
    group: np.ndarray  # (K,) of each column; 0: unit prior
    known: bool = True  # the instruments' sigmas; else the rows' noise may be less than one, too

    def sums(self, poses: np.ndarray | slice) -> _Sums:
        a, r = self.columns[poses].reshape(-1, len(self.group)), self.error[poses].ravel()
        return _Sums(a.T @ a, a.T @ r, float(r @ r), len(r), 1.0 if self.known else _LEAST_NOISE)

    def left(self, mean: np.ndarray, poses: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(n, m): the errors at b = mean."""
        return self.error[poses] + self.columns[poses] @ mean


@dataclass(frozen=True)
class _Sums:
    """Sufficient statistics: they add up over poses, so leaving poses out is a subtraction."""

    square: np.ndarray  # (K, K) A' A
    cross: np.ndarray  # (K,) A' r
    energy: float  # r' r
    n: int
    least_noise: float

    def without(self, other: _Sums) -> _Sums:
        square, cross, energy = self.square - other.square, self.cross - other.cross, self.energy - other.energy
        return _Sums(square, cross, energy, self.n - other.n, self.least_noise)


@dataclass(frozen=True)
class Posterior:
    mean: np.ndarray  # (K,)
    covariance: np.ndarray  # (K, K)
    precision: np.ndarray  # (n_groups,)
    noise: float  # variance of a row; at least the instruments' own, which is 1, where that is known
    freedom: float  # rows less the effective number of columns
    log_evidence: float  # logarithm of the data's probability, a constant apart


def posterior(sums: _Sums, group: np.ndarray, near: Posterior | None = None) -> Posterior:
    """The most probable widths, and b given them. Normal equations: the unit priors bound their condition.

    near: where to begin; it saves iterations.
    """
    precision, noise = np.full(int(group.max(initial=0)) + 1, _START), 1.0
    precision[0] = 1.0
    if near is not None:
        precision, noise = near.precision, near.noise
    members = [np.flatnonzero(group == g) for g in range(len(precision))]
    mean = covariance = np.zeros(0)
    freedom = float(sums.n)
    for _ in range(_ITERATIONS):
        information = sums.square / noise
        information[np.diag_indices_from(information)] += precision[group]
        covariance = _inverse(information)
        mean = -covariance @ (sums.cross / noise)
        precisions = precision.copy()
        for g, columns in enumerate(members):
            if g and len(columns):
                determined = len(columns) - precision[g] * float(np.sum(np.diag(covariance)[columns]))
                wanted = determined / max(float(np.sum(mean[columns] ** 2)), 1e-300)
                precisions[g] = np.clip(wanted, *_PRECISIONS) if determined > _GONE else _PRECISIONS[1]
        effective = len(group) - float(np.sum(precision[group] * np.diag(covariance)))
        left = float(sums.energy + 2 * mean @ sums.cross + mean @ sums.square @ mean)
        freedom = max(sums.n - effective, 1.0)
        wider = max(left / freedom, sums.least_noise)
        moved = max(np.max(np.abs(np.log(precisions / precision))), abs(np.log(wider / noise)))
        precision, noise = precisions, wider
        if moved < _SETTLED:
            break
    return Posterior(mean, covariance, precision, noise, freedom, _log_evidence(sums, group, precision, noise, mean))


def _log_evidence(sums: _Sums, group: np.ndarray, precision: np.ndarray, noise: float, mean: np.ndarray) -> float:
    information = sums.square / noise + np.diag(precision[group])
    square = (sums.energy + 2 * mean @ sums.cross + mean @ sums.square @ mean) / noise
    square += float(np.sum(precision[group] * mean**2)) + sums.n * np.log(noise)
    return -0.5 * float(square + np.linalg.slogdet(information)[1] - np.sum(np.log(precision[group])))


def _inverse(information: np.ndarray) -> np.ndarray:
    """Of a positive definite matrix, by its Cholesky factor: half the work of solving for the identity."""
    factor, failed = dpotrf(information, lower=1)
    inverse, singular = dpotri(factor, lower=1)
    if failed or singular:
        raise FloatingPointError("the information of a linear fit is not positive definite")
    whole = inverse + inverse.T  # above the diagonal `dpotrf` has left zeros
    whole.reshape(-1)[:: len(whole) + 1] /= 2
    return whole


@dataclass(frozen=True)
class Unseen:
    """Errors of every pose by the fit that has not seen it, and what that fit thought of them."""

    error: np.ndarray  # (n, m)
    spread: np.ndarray  # (n, m, m) of the prediction, the noise apart

    @property
    def square(self) -> np.ndarray:
        """(n,) of each pose's whitened error."""
        return np.sum(self.error**2, axis=1)

    @property
    def loss(self) -> float:
        """Mean logarithm of 1 + square: no single pose decides."""
        return float(np.mean(np.log1p(self.square)))


def cross_validated(rows: Rows, folds: Sequence[np.ndarray]) -> tuple[Posterior, Unseen]:
    """The posterior of all poses, and each one's error without its fold: the widths have not seen it either."""
    whole = rows.sums(slice(None))
    all_seen = posterior(whole, rows.group)
    error, spread = np.zeros_like(rows.error), np.zeros((*rows.error.shape, rows.error.shape[1]))
    for fold in folds:
        fold_posterior = posterior(whole.without(rows.sums(fold)), rows.group, all_seen)
        error[fold] = rows.left(fold_posterior.mean, fold)
        spread[fold] = variance(rows.columns[fold], fold_posterior.covariance)
    return all_seen, Unseen(error, spread)


def inflation(error: np.ndarray, spread: np.ndarray, noise: float = 1.0) -> float:
    """What `spread` (n, m, m) must be multiplied by, so that unseen errors (n, m) lie as far out as it says.

    An error's covariance is the instruments', `noise`, and the spread. The rank of the quantile is that of conformal
    prediction (Vovk, Gammerman, Shafer 2005): one more pose lies within with that probability.
    """
    n, m = error.shape
    # where the noise hides the spread, the spread is believed
    seen = float(np.trace(np.mean(spread, axis=0))) / m / noise
    trust = seen / (1 + seen)
    held = HELD if n >= _ENOUGH else _FEW
    reach, rank = chdtri(m, 1 - held), min(int(np.ceil(held * (n + 1))), n) - 1

    def distance(factor: float) -> float:
        square = np.linalg.solve(noise * np.eye(m) + factor * spread, error[..., None])[..., 0]
        return float(np.sort(np.sum(error * square, axis=1))[rank])

    low, high = np.log(_INFLATION)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if distance(float(np.exp(middle))) > reach else (low, middle)
    return float(np.exp(trust * (low + high) / 2))
