"""Estimators of linear problems, and how much they shrink, against textbook formulas on tall matrices.

Problems at random: columns of very different length, W's and T's columns lean on the geometry, some of them are null.
Here nothing is projected, truncated or standardised by singular values unless the definition says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.shrinkage import (
    N_FRAMES,
    Linear,
    choose_by_folds,
    choose_by_gcv,
    columns_scale,
    identifiable,
    standardise,
    uncertainty,
)

ESTIMATORS = ("least_squares", "ridge", "liu", "truncated_svd", "map")
SOME = {"least_squares": (0.0,), "ridge": (0.0, 0.3, 20.0), "liu": (0.0, 0.4, 1.0), "truncated_svd": (1, 3, 5),
        "map": (0.5, 1.0, 7.0)}  # fmt: skip
seeds = st.integers(0, 10**6)


@dataclass(frozen=True)
class Problem:
    """y = A g + F f + noise: geometry g (n,), and f: W and T, two of whose twelve columns nothing sees."""

    a: np.ndarray
    f: np.ndarray
    y: np.ndarray
    tolerance: np.ndarray  # (n + 12,)

    @staticmethod
    def random(seed: int, n: int = 5, rows: int = 40, rank: int | None = None) -> Problem:
        random = np.random.default_rng(seed)
        f = random.normal(size=(rows, N_FRAMES))
        a = random.normal(size=(rows, n)) @ np.diag(10.0 ** random.uniform(-1, 1, n)) @ random.normal(size=(n, n))
        a += f[:, :n] * random.normal()
        f[:, [3, 4]] = 0
        if rank is not None:
            a = a[:, :rank] @ random.normal(size=(rank, n))
        tolerance = 10.0 ** random.uniform(-1.5, 0.5, n)
        truth = tolerance * random.normal(size=n)
        y = a @ truth + f @ random.normal(size=N_FRAMES) * 10 + random.normal(size=rows)
        return Problem(a, f, y, np.concatenate([tolerance, np.full(N_FRAMES, np.inf)]))

    @property
    def linear(self) -> Linear:
        triangle = np.linalg.qr(np.column_stack([self.a, self.f, self.y]), mode="r")
        return Linear(triangle, len(self.y))

    def part(self, rows: np.ndarray) -> Problem:
        return Problem(self.a[rows], self.f[rows], self.y[rows], self.tolerance)

    def scale(self, estimator: str) -> np.ndarray:
        """D: tolerances, or columns of unit length once W and T are regressed out of them."""
        if estimator in ("map", "least_squares"):
            return self.tolerance[: self.a.shape[1]]
        return 1 / np.linalg.norm(self.without_frames(self.a), axis=0)

    def without_frames(self, columns: np.ndarray) -> np.ndarray:
        return columns - self.f @ (np.linalg.pinv(self.f) @ columns)

    def operator(self, estimator: str, shrinkage: float, scale: np.ndarray) -> np.ndarray:
        """(n + 12, rows): the estimate of geometry and frames is this times y."""
        x, n = self.without_frames(self.a) * scale, self.a.shape[1]
        square, eye = x.T @ x, np.eye(n)
        if estimator == "truncated_svd":
            u, s, vt = np.linalg.svd(x, full_matrices=False)
            k = round(shrinkage)
            found = vt[:k].T @ np.diag(1 / s[:k]) @ u[:, :k].T
        elif estimator == "liu":
            found = np.linalg.solve(square + eye, square + shrinkage * eye) @ np.linalg.solve(square, x.T)
        else:
            added = {"least_squares": 0.0, "ridge": shrinkage, "map": 1 / shrinkage**2 if shrinkage else 0.0}[estimator]
            found = np.linalg.solve(square + added * eye, x.T)
        geometry = scale[:, None] * found
        frames = np.linalg.pinv(self.f) @ (np.eye(len(self.y)) - self.a @ geometry)
        # x.T y = x.T (y without frames): the same geometry
        return np.concatenate([geometry, frames])

    def hat(self, estimator: str, shrinkage: float, scale: np.ndarray) -> np.ndarray:
        return np.column_stack([self.a, self.f]) @ self.operator(estimator, shrinkage, scale)


@given(seed=seeds)
def test_scale_is_the_tolerances_or_makes_columns_of_unit_length(seed):
    problem = Problem.random(seed)
    for estimator in ESTIMATORS:
        found = columns_scale(problem.linear.triangle, estimator, problem.tolerance)
        np.testing.assert_allclose(found, problem.scale(estimator), rtol=1e-9)


def test_columns_that_are_not_seen_have_no_scale():
    """One of zeros, one of rounding alone, one that is W's."""
    problem = Problem.random(1)
    a = problem.a.copy()
    a[:, 0], a[:, 1], a[:, 2] = 0, 1e-14, problem.f[:, 0]
    triangle = np.column_stack([a, problem.f, problem.y])
    assert list(columns_scale(triangle, "ridge", problem.tolerance) > 0) == [False, False, False, True, True]
    assert np.all(columns_scale(triangle, "map", problem.tolerance) > 0)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@given(seed=seeds)
def test_estimates_are_the_textbooks(estimator, seed):
    """Geometry by each formula, W and T regressed on what it leaves: at several shrinkages."""
    problem = Problem.random(seed)
    scale = problem.scale(estimator)
    data = standardise(problem.linear, scale)
    for shrinkage in SOME[estimator]:
        expected = problem.operator(estimator, shrinkage, scale) @ problem.y
        found = data.geometry(data.filter(estimator, shrinkage))
        np.testing.assert_allclose(found, expected[:-N_FRAMES], rtol=1e-6, atol=1e-8 * np.abs(found).max())
        triangle = problem.linear.triangle
        frames = data.frames @ triangle[:, -1] - data.coupling @ found
        np.testing.assert_allclose(frames, expected[-N_FRAMES:], rtol=1e-6, atol=1e-7 * np.abs(frames).max())


@given(seed=seeds)
def test_estimates_without_shrinkage_are_least_squares(seed):
    """k to 0, d = 1, all directions, priors without limit: numpy's lstsq of all columns at once."""
    problem = Problem.random(seed)
    whole = np.column_stack([problem.a, problem.f])
    expected = np.linalg.lstsq(whole, problem.y, rcond=1e-12)[0][:-N_FRAMES]
    for estimator, shrinkage in (("ridge", 1e-12), ("ridge", 0), ("liu", 1), ("truncated_svd", 5), ("map", 1e6)):
        data = standardise(problem.linear, problem.scale(estimator))
        found = data.geometry(data.filter(estimator, shrinkage))
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("estimator", ESTIMATORS)
@given(seed=seeds, rank=st.integers(1, 4))
def test_estimates_keep_to_the_identifiable_subspace(estimator, seed, rank):
    """Dependent columns: nothing along their null space (in units of the scale), and the fit of the minimum norm."""
    problem = Problem.random(seed, rank=rank)
    scale = problem.scale(estimator)
    within = identifiable(problem.linear, scale)
    assert within.shape == (rank, 5)
    x = problem.without_frames(problem.a) * scale
    null = np.linalg.svd(x)[2][rank:]
    np.testing.assert_allclose(within @ null.T, 0, atol=1e-9)
    data = standardise(problem.linear, scale, within)
    found = data.geometry(data.filter(estimator, {"ridge": 0.0, "truncated_svd": rank, "map": 1e9}.get(estimator, 1.0)))
    np.testing.assert_allclose(null @ (found / scale), 0, atol=1e-7 * np.abs(found / scale).max())
    expected = scale * (np.linalg.pinv(x, rcond=1e-10) @ problem.y)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def scores_by_hat_matrix(problem: Problem, estimator: str, scale: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """rows |y - H y|^2 / (rows - trace H)^2, Golub, Heath, Wahba 1979."""
    n = len(problem.y)
    scores = []
    for c in candidates:
        h = problem.hat(estimator, c, scale)
        scores.append(n * np.sum((problem.y - h @ problem.y) ** 2) / (n - np.trace(h)) ** 2)
    return np.array(scores)


def assert_least(found: float, candidates: np.ndarray, scores: np.ndarray, estimator: str) -> None:
    """The candidate of least score; of priors' scales whose scores differ by no more than 0.1 %, the nearest to 1."""
    at = int(np.argmin(np.abs(candidates - found)))
    assert candidates[at] == pytest.approx(found, rel=1e-9)
    if estimator == "map":
        alike = candidates[scores <= scores.min() * (1 + 1e-3)]
        assert abs(np.log(found)) == pytest.approx(np.min(np.abs(np.log(alike))), abs=1e-6)
    else:
        assert scores[at] <= scores.min() * (1 + 1e-7)


@pytest.mark.parametrize("estimator", ESTIMATORS[1:])
@pytest.mark.parametrize("seed", range(4))
def test_generalised_cross_validation_by_the_hat_matrix(estimator, seed):
    problem = Problem.random(seed, rows=30)
    scale = problem.scale(estimator)
    data = standardise(problem.linear, scale)
    candidates = data.candidates(estimator)
    scores = scores_by_hat_matrix(problem, estimator, scale, candidates)
    assert_least(choose_by_gcv(data, estimator), candidates, scores, estimator)


@pytest.mark.parametrize("estimator", ESTIMATORS[1:])
@pytest.mark.parametrize("seed", range(2))
def test_cross_validation_by_explicit_refits(estimator, seed):
    """Six parts, each predicted by the textbook estimate from the other five."""
    problem = Problem.random(10 + seed, rows=48)
    scale = problem.scale(estimator)
    parts = np.array_split(np.random.default_rng(seed).permutation(48), 6)
    linear = [problem.part(rows).linear for rows in parts]
    candidates = standardise(problem.linear, scale).candidates(estimator)
    errors = np.zeros(len(candidates))
    for rows in parts:
        others = problem.part(np.setdiff1d(np.arange(48), rows))
        left_out = problem.part(rows)
        for k, c in enumerate(candidates):
            p = others.operator(estimator, c, scale) @ others.y
            errors[k] += np.sum((np.column_stack([left_out.a, left_out.f]) @ p - left_out.y) ** 2)
    assert_least(choose_by_folds(linear, scale, None, estimator), candidates, errors, estimator)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@given(seed=seeds)
def test_covariance_is_noise_and_what_shrinkage_misses(estimator, seed):
    """Truths of the tolerances' size: G (noise) G' + (G J - 1) T^2 (G J - 1)', G the textbook operator."""
    problem = Problem.random(seed)
    scale, n = problem.scale(estimator), len(problem.tolerance)
    whole = np.column_stack([problem.a, problem.f])
    data = standardise(problem.linear, scale)
    for shrinkage in SOME[estimator]:
        operator = problem.operator(estimator, shrinkage, scale)
        missed = operator @ whole - np.eye(n)
        missed[:, -N_FRAMES:] = 0  # the estimate follows W and T whatever they are, but for what nothing sees
        missed[:, :-N_FRAMES] *= problem.tolerance[:-N_FRAMES]
        expected = operator @ operator.T + missed @ missed.T
        found = uncertainty(data, data.filter(estimator, shrinkage), problem.tolerance)
        np.testing.assert_allclose(found.covariance, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())
        assert found.effective == pytest.approx(np.trace(problem.hat(estimator, shrinkage, scale)), abs=1e-6)
        np.testing.assert_allclose(
            found.resolution[:-N_FRAMES], np.diag(operator @ whole)[:-N_FRAMES], rtol=1e-5, atol=1e-7
        )
        assert list(np.flatnonzero(found.unseen)) == [5 + 3, 5 + 4]


@given(seed=seeds, scale=st.sampled_from([0.5, 1.0, 3.0]))
def test_covariance_of_map_is_the_inverse_of_the_information(seed, scale):
    """(J'J + P)^-1, P the priors' inverse variances at that scale; the columns that nothing sees struck out."""
    problem = Problem.random(seed)
    believed = scale * problem.tolerance
    data = standardise(problem.linear, problem.scale("map"))
    found = uncertainty(data, data.filter("map", scale), believed)
    whole, seen = np.column_stack([problem.a, problem.f]), ~found.unseen
    expected = np.linalg.inv((whole.T @ whole + np.diag(1 / believed**2))[np.ix_(seen, seen)])
    np.testing.assert_allclose(found.covariance[np.ix_(seen, seen)], expected, rtol=1e-5, atol=1e-8 * expected.max())
    shares = 1 - np.diag(expected)[:5] / believed[:5] ** 2
    np.testing.assert_allclose(found.resolution[:5], shares, rtol=1e-5, atol=1e-9)
