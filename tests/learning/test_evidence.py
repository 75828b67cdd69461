"""Bayesian linear regression by evidence, against numpy's dense formulas, scikit-learn and simulation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, multivariate_normal

from kincal.learning.evidence import Posterior, Rows, cross_validated, inflation, posterior

ALL = slice(None)


def rows(n: int, m: int, sizes: tuple[float, ...], noise: float = 1.0, seed: int = 0, width: int = 3) -> Rows:
    """n poses of m rows: a group of `width` columns for each of `sizes`, the sigma of its true b."""
    random = np.random.default_rng([seed, 5])
    group = np.repeat(np.arange(len(sizes)), width)
    columns = 3 * random.normal(size=(n, m, len(group)))
    b = random.normal(size=len(group)) * np.array(sizes)[group]
    return Rows(noise * random.normal(size=(n, m)) - columns @ b, columns, group)


def dense(data: Rows, found: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of b given the widths that were found, by the gain of a Kalman update."""
    a, r = data.columns.reshape(-1, len(data.group)), data.error.ravel()
    prior = np.diag(1 / found.precision[data.group])
    gain = prior @ a.T @ np.linalg.inv(a @ prior @ a.T + found.noise * np.eye(len(r)))
    return -gain @ r, prior - gain @ a @ prior


def log_probability(data: Rows, precision: np.ndarray, noise: float) -> float:
    """Of the errors, b integrated out: a normal density of all rows at once."""
    a, r = data.columns.reshape(-1, len(data.group)), data.error.ravel()
    return multivariate_normal.logpdf(r, cov=noise * np.eye(len(r)) + (a / precision[data.group]) @ a.T)


CASES = [(10, 3, (1.0, 0.5), 1.0), (40, 3, (1.0, 2.0, 0.1), 1.7), (6, 2, (1.0, 0.3, 3.0), 1.2), (30, 1, (0.2,), 3.0)]


@pytest.mark.parametrize("n, m, sizes, noise", CASES)
def test_posterior(n, m, sizes, noise):
    """Against the dense formulas, at the widths found."""
    data = rows(n, m, sizes, noise)
    found = posterior(data.sums(ALL), data.group)
    mean, covariance = dense(data, found)
    assert found.precision[0] == 1.0
    np.testing.assert_allclose(found.mean, mean, rtol=0, atol=2e-3 * np.abs(mean).max())
    np.testing.assert_allclose(found.covariance, covariance, rtol=0, atol=2e-2 * np.abs(covariance).max())
    settled = posterior(data.sums(ALL), data.group, found)
    again = dense(data, replace(settled, precision=found.precision, noise=found.noise))
    np.testing.assert_allclose(again[0], mean, rtol=1e-12)


@pytest.mark.parametrize("n, m, sizes, noise", CASES)
def test_log_evidence(n, m, sizes, noise):
    """Differences between data of equal size against a normal density of all rows: the constant is the same."""
    apart = []
    for seed in (1, 2, 3):
        data = rows(n, m, sizes, noise, seed)
        found = posterior(data.sums(ALL), data.group)
        apart.append(found.log_evidence - log_probability(data, found.precision, found.noise))
    np.testing.assert_allclose(apart, apart[0], rtol=0, atol=1e-3)


def test_the_widths_are_the_most_probable_ones():
    """The probability of the data falls in every direction from them."""
    data = rows(60, 3, (1.0, 2.0, 0.05), noise=1.8)
    found = posterior(data.sums(ALL), data.group)
    best = log_probability(data, found.precision, found.noise)
    for factor in (0.7, 1.4):
        assert log_probability(data, found.precision, factor * found.noise) < best
        for group in (1, 2):
            other = found.precision.copy()
            other[group] *= factor
            assert log_probability(data, other, found.noise) < best


@pytest.mark.parametrize("seed", range(3))
def test_against_scikit_learn(seed):
    """One group of columns and noise above the instrument's: the same problem as BayesianRidge's."""
    linear_model = pytest.importorskip("sklearn.linear_model")
    data = rows(60, 2, (1.0, 0.7), noise=2.5, seed=seed, width=6)
    data = Rows(data.error, data.columns[..., 6:], np.ones(6, dtype=int))
    found = posterior(data.sums(ALL), data.group)
    ridge = linear_model.BayesianRidge(
        tol=1e-10, max_iter=5000, alpha_1=0, alpha_2=0, lambda_1=0, lambda_2=0, fit_intercept=False
    )
    ridge.fit(data.columns.reshape(-1, 6), -data.error.ravel())
    np.testing.assert_allclose(found.mean, ridge.coef_, rtol=0, atol=1e-3 * np.abs(ridge.coef_).max())
    assert found.noise == pytest.approx(1 / ridge.alpha_, rel=1e-2)
    assert found.precision[1] == pytest.approx(ridge.lambda_, rel=3e-2)
    np.testing.assert_allclose(found.covariance, ridge.sigma_, rtol=0, atol=2e-2 * np.abs(ridge.sigma_).max())


def test_noise_is_never_less_than_the_instruments():
    """Unless nobody knows these: then it is what it is, folds left out or not."""
    data = rows(50, 3, (1.0, 1.0), noise=0.2)
    assert posterior(data.sums(ALL), data.group).noise == 1.0
    unknown = replace(data, known=False)
    for sums in (unknown.sums(ALL), unknown.sums(ALL).without(unknown.sums(slice(0, 5)))):
        assert posterior(sums, data.group).noise == pytest.approx(0.04, rel=0.3)


def test_what_is_not_there_is_pruned():
    """A group of columns that explain nothing is shrunk to nothing beside the noise; one that does is not."""
    data = rows(200, 3, (1.0, 0.0, 2.0))
    found = posterior(data.sums(ALL), data.group)
    lost, kept = data.columns[..., data.group == 1], found.mean[data.group == 1]
    assert np.sqrt(np.mean((lost @ kept) ** 2)) < 0.2
    assert found.precision[1] > 100 * found.precision[2]


@given(seed=st.integers(0, 30), n=st.integers(4, 30), out=st.integers(1, 3))
def test_sums_without_a_fold(seed, n, out):
    """Leaving out by subtraction against the sums and the posterior of the other poses alone."""
    data = rows(n, 3, (1.0, 0.5), 1.3, seed)
    fold = np.random.default_rng(seed).choice(n, out, replace=False)
    kept = np.setdiff1d(np.arange(n), fold)
    found, expected = data.sums(ALL).without(data.sums(fold)), data.sums(kept)
    np.testing.assert_allclose(found.square, expected.square, rtol=0, atol=1e-11 * np.abs(expected.square).max())
    np.testing.assert_allclose(found.cross, expected.cross, rtol=0, atol=1e-11 * np.abs(expected.cross).max())
    assert (found.n, found.energy) == (expected.n, pytest.approx(expected.energy, rel=1e-9))
    one, other = (posterior(sums, data.group) for sums in (found, expected))
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-8 * np.abs(other.mean).max())


def test_unseen_errors():
    """Of each fold by the fit of the others, from scratch; and the spread that this fit gives them."""
    data = rows(30, 3, (1.0, 0.5), 1.5)
    folds = np.array_split(np.random.default_rng(0).permutation(30), 5)
    found, unseen = cross_validated(data, folds)
    for fold in folds:
        kept = np.setdiff1d(np.arange(30), fold)
        own = posterior(data.sums(kept), data.group)
        expected = data.error[fold] + data.columns[fold] @ own.mean
        np.testing.assert_allclose(unseen.error[fold], expected, rtol=0, atol=2e-3)
        for k in fold:
            spread = data.columns[k] @ own.covariance @ data.columns[k].T
            np.testing.assert_allclose(unseen.spread[k], spread, rtol=0, atol=2e-2 * np.abs(spread).max())
    seen = np.sum(data.left(found.mean) ** 2)
    assert seen < np.sum(unseen.error**2)
    assert unseen.loss == pytest.approx(np.mean(np.log(1 + np.sum(unseen.error**2, axis=1))), rel=1e-12)


def test_evidence_prefers_the_model_that_made_the_data():
    """With the columns against without them, over ten robots each that have and have not these errors."""
    for size in (0.0, 0.3):
        better = []
        for seed in range(10):
            data = rows(40, 3, (1.0, size), seed=seed)
            small = Rows(data.error, data.columns[..., :3], data.group[:3])
            one, other = (posterior(d.sums(ALL), d.group) for d in (data, small))
            better.append(one.log_evidence - other.log_evidence > np.log(20))
        assert sum(better) == (10 if size else 0)


# Regions that hold


def drawn(n: int, factor: float, seed: int, spread_size: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors with covariance 1 + factor * spread, and spread (n, 2, 2), another one for each pose."""
    random = np.random.default_rng([seed, 9])
    root = np.sqrt(spread_size) * random.normal(size=(n, 2, 2))
    spread = root @ root.swapaxes(1, 2)
    error = random.normal(size=(n, 2)) + np.sqrt(factor) * (root @ random.normal(size=(n, 2, 1)))[..., 0]
    return error, spread


def held(error: np.ndarray, spread: np.ndarray, factor: float) -> float:
    """Share of errors within the 95 % region of covariance 1 + factor * spread."""
    inverse = np.linalg.inv(np.eye(2) + factor * spread)
    return float(np.mean(np.einsum("ni,nij,nj->n", error, inverse, error) < chi2.ppf(0.95, 2)))


@pytest.mark.parametrize("n", [60, 150])
@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0, 25.0])
def test_inflated_regions_hold(n, factor):
    """Found on n poses, tried on others: 95 % of all lie within, whatever factor the spread was told wrong by."""
    shares = []
    for seed in range(30):
        found = inflation(*drawn(n, factor, seed, spread_size=100.0))
        shares.append(held(*drawn(400, factor, seed + 1000, spread_size=100.0), found))
    assert np.mean(shares) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("noise", [1e-4, 100.0])
def test_inflation_in_another_unit(noise):
    """Errors, noise and spread scaled together: the same factor."""
    error, spread = drawn(100, 4.0, 2)
    expected = inflation(error, spread)
    assert inflation(np.sqrt(noise) * error, noise * spread, noise) == pytest.approx(expected, rel=1e-9)


def test_inflation_of_a_known_factor():
    """Many poses: the factor itself, but for what is left to trust in the spread."""
    found = [inflation(*drawn(4000, factor, 1, spread_size=100.0)) for factor in (1.0, 9.0)]
    assert found == pytest.approx([1.0, 9.0], rel=0.15)


def test_a_spread_that_noise_hides_is_believed():
    """Errors of noise alone say nothing of a spread of a thousandth of it."""
    error, spread = drawn(50, 0.0, 3)
    assert inflation(error, 1e-4 * spread) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("n", [1, 2, 5, 39, 40])
def test_inflation_of_few_poses_is_a_number(n):
    found = inflation(*drawn(n, 1.0, 4))
    assert 0.1 <= found <= 1e4
