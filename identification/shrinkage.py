"""The estimators as one family: shrinkage of least squares along the singular directions of a standardised Jacobian.

W and T have flat priors and play the intercept's part: they are projected out, the geometry A that stays is
standardised by columns D, A D = U diag(s) V'. An estimate of the geometry is D V diag(f(s) / s) U' b, and its estimator
is the filter f:

    least squares   1 on the identifiable subspace
    truncated SVD   1 for the k largest s
    ridge           s^2 / (s^2 + k)
    Liu             (s^2 + d) / (s^2 + 1)         Liu 1993, Commun. Statist. Theory Meth. 22, 393-402
    MAP             s^2 / (s^2 + 1 / scale^2)     D: the tolerances; ridge and Liu: columns of unit length

k, d and the scale of the priors are chosen by generalised cross-validation (Golub, Heath, Wahba 1979) or by k-fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kincal.identification.identifiability import FLAT_SCALE, rank_tolerance
from kincal.identification.least_squares import NULL
from kincal.identification.singular_values import svd

_TIE = 1e-3  # of a score, relative: less than data of any size could tell
_UNFELT = 1e-9  # relative to the column that is felt most: rounding
N_FRAMES = 12  # of the parameters, the last: W and T
_SCALES = np.geomspace(1e-2, 1e2, 161)  # of the priors
_RIDGES = np.geomspace(1e-10, 1e4, 281)  # times the mean of s^2
_LIU = np.linspace(0, 1, 101)


@dataclass(frozen=True)
class Linear:
    """A linear model |triangle (p, -1)| of the data about some estimate: (m, n_parameters + 1), of `rows` rows."""

    triangle: np.ndarray
    rows: int


@dataclass(frozen=True)
class Standardised:
    """The geometry of a linear model with W and T projected out, in its singular directions."""

    scale: np.ndarray  # (n_geometry,) D; 0: the data do not see the parameter at all
    s: np.ndarray  # (k,) descending
    vt: np.ndarray  # (k, n_geometry)
    along: np.ndarray  # (k,) U' b
    left: float  # |b|^2 outside of U
    frames: np.ndarray  # (12, m) pseudo-inverse of W's and T's columns
    frames_rank: int
    frames_null: np.ndarray  # (12, i) orthonormal: directions of W and T that the data never see
    coupling: np.ndarray  # (12, n_geometry): how W and T follow the geometry
    rows: int

    def filter(self, estimator: str, shrinkage: float) -> np.ndarray:
        """f of the singular directions, (k,)."""
        square = self.s**2
        if estimator == "least_squares":
            return np.ones(len(self.s))
        if estimator == "truncated_svd":
            return 1.0 * (np.arange(len(self.s)) < round(shrinkage))
        if estimator == "liu":
            return (square + shrinkage) / (square + 1)
        weight = 1 / shrinkage**2 if estimator == "map" else shrinkage
        return square / np.maximum(square + weight, 1e-300)

    def geometry(self, f: np.ndarray) -> np.ndarray:
        """(.., n_geometry): the estimates of filters f: (.., k)."""
        gain = f / np.maximum(self.s, 1e-300)
        return (gain * self.along) @ self.vt * self.scale

    def candidates(self, estimator: str) -> np.ndarray:
        if estimator == "map":
            return _SCALES
        if estimator == "liu":
            return _LIU
        if estimator == "truncated_svd":
            return np.arange(len(self.s) + 1.0)
        return _RIDGES * (float(np.mean(self.s**2)) if len(self.s) else 1.0)


def columns_scale(triangle: np.ndarray, estimator: str, tolerance: np.ndarray) -> np.ndarray:
    """D: the tolerances for MAP and least squares, columns of unit length (W and T projected out) for the others."""
    n = len(tolerance) - N_FRAMES
    if estimator in ("map", "least_squares"):
        return tolerance[:n]
    length = np.linalg.norm(without_frames(triangle)[:, :n], axis=0)
    felt = length * tolerance[:n]
    seen = felt > _UNFELT * np.max(felt, initial=0.0)
    return np.where(seen, 1 / np.where(seen, length, 1.0), 0.0)


def without_frames(triangle: np.ndarray) -> np.ndarray:
    """The triangle with W's and T's columns projected out of all others."""
    u = _frames(triangle)[0]
    return triangle - u @ (u.T @ triangle)


def _frames(triangle: np.ndarray):
    u, s, vt = svd(triangle[:, -1 - N_FRAMES : -1] * FLAT_SCALE, full_matrices=True)
    rank = int(np.sum(s > max(NULL * s[0], FLAT_SCALE)))  # what is not told to 1 m or 1 rad is not told
    return u[:, :rank], s[:rank], vt[:rank], vt[rank:].T


def standardise(linear: Linear, scale: np.ndarray, within: np.ndarray | None = None) -> Standardised:
    """within: (k, n_geometry), orthonormal in standardised parameters: the subspace that estimates keep to."""
    triangle, n = linear.triangle, len(scale)
    u, s, vt, null = _frames(triangle)
    frames = FLAT_SCALE * (vt.T / s) @ u.T
    left_over = without_frames(triangle)
    projected, b_left = left_over[:, :n], left_over[:, -1]
    projected = projected * scale if within is None else projected * scale @ within.T
    left_vectors, singular, right = svd(projected)
    along = left_vectors.T @ b_left
    left = max(float(b_left @ b_left - along @ along), 0.0)
    right = right if within is None else right @ within
    coupling = frames @ triangle[:, :n]
    return Standardised(scale, singular, right, along, left, frames, len(s), null, coupling, linear.rows)


def identifiable(linear: Linear, scale: np.ndarray) -> np.ndarray:
    """(rank, n_geometry): what the data of the robot as drawn can see, to be `within`. There the gap is wide.

    As built, every axis a little off, effects of second order fill the gap with what no measurement can tell.
    """
    data = standardise(linear, scale)
    rank = int(np.sum(data.s > rank_tolerance(data.s, linear.rows))) if len(data.s) and data.s[0] > 0 else 0
    return data.vt[:rank]


def choose_by_gcv(data: Standardised, estimator: str) -> float:
    """The shrinkage with the least generalised cross-validation error, (rows |residual|^2) / (rows - trace)^2."""
    candidates = data.candidates(estimator)
    f = np.stack([data.filter(estimator, c) for c in candidates])
    residual = np.sum(((1 - f) * data.along) ** 2, axis=1) + data.left
    free = data.rows - data.frames_rank - f.sum(axis=1)
    score = np.where(free > 0.5, residual / np.maximum(free, 0.5) ** 2, np.inf)
    return _least(candidates, score, estimator)


def choose_by_folds(parts: Sequence[Linear], scale: np.ndarray, within: np.ndarray | None, estimator: str) -> float:
    """The shrinkage with the least error of prediction over parts of the poses, each left out once."""
    whole = standardise(_stacked(parts), scale, within)
    candidates = whole.candidates(estimator)
    error = np.zeros(len(candidates))
    for k, part in enumerate(parts):
        others = _stacked([other for i, other in enumerate(parts) if i != k])
        data = standardise(others, scale, within)
        f = np.stack([data.filter(estimator, c) for c in candidates])
        geometry = data.geometry(f)
        frames = data.frames @ others.triangle[:, -1] - geometry @ data.coupling.T
        p = np.concatenate([geometry, frames, -np.ones((len(candidates), 1))], axis=1)
        error += np.sum((p @ part.triangle.T) ** 2, axis=1)
    return _least(candidates, error, estimator)


def _least(candidates: np.ndarray, score: np.ndarray, estimator: str) -> float:
    """The candidate of least score; of priors' scales as good as the best (a flat score), the nearest to 1."""
    if estimator == "map":
        candidates = candidates[score <= score.min() * (1 + _TIE)]
        return float(candidates[np.argmin(np.abs(np.log(candidates)))])
    return float(candidates[np.argmin(score)])


def _stacked(parts: Sequence[Linear]) -> Linear:
    return Linear(np.concatenate([p.triangle for p in parts]), sum(p.rows for p in parts))


@dataclass(frozen=True)
class Uncertainty:
    covariance: np.ndarray  # (n_parameters, n_parameters); directions that nothing sees are left out of it
    unseen: np.ndarray  # (n_parameters,) bool: the parameter takes part in such a direction: its sigma is infinite
    resolution: np.ndarray  # (n_parameters,) share of a parameter's change that its own true change makes; W, T: 1
    effective: float  # number of parameters that the data determine: trace of the hat matrix
    leverage: np.ndarray  # (n_parameters, n_parameters) L: J L J' is the hat matrix


def uncertainty(data: Standardised, f: np.ndarray, tolerance: np.ndarray) -> Uncertainty:
    """Of an estimate by filter f: its noise, and what shrinkage leaves out of true changes as large as the tolerances.

    For MAP the posterior covariance; for the others the mean squared error matrix under the same tolerances.
    """
    n = len(data.scale)
    inverse = np.where(data.scale > 0, 1 / np.where(data.scale > 0, data.scale, 1.0), 0.0)
    resolution = (data.scale[:, None] * data.vt.T * f) @ (data.vt * inverse)  # d estimate / d truth
    missed = (resolution - np.eye(n)) * tolerance[:n]
    noise = data.scale[:, None] * data.vt.T * (f / np.maximum(data.s, 1e-300))
    covariance = _with_frames(missed @ missed.T + noise @ noise.T, data)
    drawn = data.scale[:, None] * data.vt.T * (np.sqrt(f) / np.maximum(data.s, 1e-300))
    unseen = np.concatenate([np.zeros(n, dtype=bool), np.sum(data.frames_null**2, axis=1) > 1e-8])
    shares = np.concatenate([np.diag(resolution), 1.0 * ~unseen[n:]])
    effective, leverage = float(f.sum()) + data.frames_rank, _with_frames(drawn @ drawn.T, data)
    return Uncertainty(0.5 * (covariance + covariance.T), unseen, shares, effective, leverage)


def _with_frames(geometry: np.ndarray, data: Standardised) -> np.ndarray:
    """A covariance of the geometry, W and T following it."""
    across = -geometry @ data.coupling.T
    frames = data.frames @ data.frames.T + data.coupling @ geometry @ data.coupling.T
    return np.block([[geometry, across], [across.T, frames]])
