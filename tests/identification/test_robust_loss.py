"""Robust losses against their definition: derivatives, textbook constants, efficiency by Monte Carlo, gross errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurements import Measurements
from kincal.identification.robust_loss import Loss, blocks
from kincal.identification.summary import summarise
from kincal.urdf.description import Identify
from kincal.urdf.rigid_motion import exp

KINDS = ("gaussian", "huber", "cauchy")
ROBUST = KINDS[1:]
CHANNELS = {1: ("yaw",), 2: ("tilt",), 3: ("orientation",)}  # by the rows of a block
MIXED = ("tilt", "yaw", "position")


def influence(loss: Loss, u: np.ndarray, d: int) -> np.ndarray:
    """weight * u of blocks (n, d)."""
    return loss.weights(u, CHANNELS[d]) * u


def mean_slope(loss: Loss, u: np.ndarray, d: int, step: float = 1e-5) -> np.ndarray:
    """(n,): trace of the influence's derivative over d, by central differences."""
    trace = np.zeros(len(u))
    for k in range(d):
        e = np.zeros(d)
        e[k] = step
        trace += (influence(loss, u + e, d) - influence(loss, u - e, d))[:, k] / (2 * step)
    return trace / d


def test_blocks_are_the_channels_rows():
    assert list(blocks(MIXED)) == [(slice(0, 2), 2), (slice(2, 3), 1), (slice(3, 6), 3)]


@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 10**6), size=st.sampled_from([0.1, 1.0, 5.0, 100.0]))
def test_derivative_of_the_cost_is_weight_times_residual(kind, seed, size):
    """Central differences, several channels at once: what reweighted least squares minimises is the cost."""
    residual = size * np.random.default_rng(seed).normal(size=(4, 6))
    loss, step = Loss(kind), 1e-5 * size
    expected = loss.weights(residual, MIXED) * residual
    for at in np.ndindex(residual.shape):
        e = np.zeros_like(residual)
        e[at] = step
        slope = (loss.cost(residual + e, MIXED) - loss.cost(residual - e, MIXED)) / (2 * step)
        assert slope == pytest.approx(expected[at], rel=1e-5, abs=1e-6 * size)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_weights_fall_with_the_length_and_turn_with_the_residual(kind, d):
    """None above that of 0, none below 0, never rising; blocks of one length have one weight."""
    random = np.random.default_rng(d)
    direction = random.normal(size=(400, d))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    length = np.sort(random.exponential(4.0, 400))
    loss = Loss(kind)
    weights = loss.weights(length[:, None] * direction, CHANNELS[d])
    np.testing.assert_allclose(weights, weights[:, :1] * np.ones(d))
    turned = loss.weights(length[:, None] * direction[::-1], CHANNELS[d])
    np.testing.assert_allclose(weights, turned, rtol=1e-12)
    greatest = loss.weights(np.zeros((1, d)), CHANNELS[d])[0, 0]
    assert np.all((weights > 0) & (weights <= greatest))
    assert np.all(np.diff(weights[:, 0]) <= 1e-15)
    if kind == "gaussian":
        np.testing.assert_array_equal(weights, 1.0)
    elif kind == "cauchy":  # redescending: what is far off has no say
        assert np.linalg.norm(influence(loss, np.full((1, d), 1e4), d)) < 1e-2
    else:  # bounded
        far = np.linalg.norm(influence(loss, np.array([[1e2] * d, [1e4] * d]), d), axis=1)
        assert far[0] == pytest.approx(far[1])


def test_constants_of_one_dimension_are_the_textbooks():
    """1.345 (Huber) and 2.385 (Cauchy), read off the weights: c / u, and 1 / (1 + (u / c)^2)."""
    u = np.array([[0.0], [50.0]])
    still, far = Loss("huber").weights(u, ("yaw",))[:, 0]
    assert 50.0 * far / still == pytest.approx(1.345, abs=1e-3)
    still, far = Loss("cauchy").weights(u, ("yaw",))[:, 0]
    assert 50.0 / np.sqrt(still / far - 1) == pytest.approx(2.385, abs=1e-3)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("kind", ROBUST)
def test_on_gaussian_noise_the_loss_curves_like_least_squares(kind, d):
    """Mean slope 1: priors weigh what they do beside a sum of squares; weighted squares of mean 1; 95 % efficient.

    Means over 200 000 blocks: their own standard errors, five of them allowed (and the integration's 1e-4).
    """
    u = np.random.default_rng(10 + d).normal(size=(200_000, d))
    loss = Loss(kind)
    slope = mean_slope(loss, u, d)
    square = np.sum(influence(loss, u, d) ** 2, axis=1) / d
    through = np.sum(influence(loss, u, d) * u, axis=1) / d
    for values, mean in ((slope, 1.0), (square, 1 / 0.95), (through, 1.0)):
        assert values.mean() == pytest.approx(mean, abs=5 * values.std() / np.sqrt(len(u)) + 1e-4)


@pytest.mark.parametrize("d", [1, 3])
@pytest.mark.parametrize("kind", ROBUST)
def test_a_location_is_found_with_95_percent_of_the_means_efficiency(kind, d):
    """3000 samples of 200 readings: variance of their mean over that of the reweighted mean.

    The two are correlated (0.95 squared), so their ratio is known to sqrt(4 * 0.05 / (3000 d)) = 0.8 %; 3 % allowed.
    """
    samples = np.random.default_rng(20 + d).normal(size=(3000, 200, d))
    centre = np.median(samples, axis=1)
    loss = Loss(kind)
    for _ in range(12):
        u = (samples - centre[:, None]).reshape(-1, d)
        weights = loss.weights(u, CHANNELS[d])[:, 0].reshape(3000, 200, 1)
        centre = np.sum(weights * samples, axis=1) / np.sum(weights, axis=1)
    assert np.var(samples.mean(axis=1)) / np.var(centre) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_information_of_a_reading(kind, d):
    """0.95 of least squares' for ordinary readings; for others (numerical slope)^2 / mean square of the influence."""
    random, loss = np.random.default_rng(30 + d), Loss(kind)
    direction = random.normal(size=(60, d))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    limit = np.sqrt(chi2.ppf(1 - 1e-4, d))
    ordinary = loss.information(random.uniform(0, limit, (60, 1)) * direction, CHANNELS[d])
    np.testing.assert_allclose(ordinary, 1.0 if kind == "gaussian" else 0.95, atol=1e-5)
    if kind == "gaussian":
        return
    far = random.uniform(1.001 * limit, 40, (60, 1)) * direction
    square = np.sum(influence(loss, far, d) ** 2, axis=1) / d
    expected = np.maximum(mean_slope(loss, far, d), 0.0) ** 2 / square
    found = loss.information(far, CHANNELS[d])
    np.testing.assert_allclose(found, expected[:, None] * np.ones(d), rtol=1e-5, atol=1e-9)
    assert np.all(found < 0.95)


# Gross errors


def spoiled(measured: Measurements, poses: list[int], size: float, seed: int) -> Measurements:
    """The orientations of some poses turned by `size` [rad], each about another axis."""
    axes = np.random.default_rng(seed).normal(size=(len(poses), 3))
    axes *= size / np.linalg.norm(axes, axis=1)[:, None]
    measured.values["orientation"][poses] = measured.values["orientation"][poses] @ exp(axes)
    return measured


@pytest.mark.parametrize("seed", [1, 2])
def test_five_percent_of_poses_a_degree_off(seed, robot):
    """1750 sigmas. Robust parameters stay within their sigmas and name these poses alone; least squares' do neither."""
    loaded, wrong = robot("ups2_u"), [3, 30, 51]
    truth, tight = loaded.random_parameters(seed), ~loaded.model.parameters.flat
    measured = loaded.measure(
        truth, loaded.readings(60, seed), ("orientation",), {"orientation": 1e-5}, np.random.default_rng(seed)
    )
    measured = spoiled(measured, wrong, np.deg2rad(1.0), seed)
    fresh = loaded.readings(50, 90)
    registered = register(loaded.model, measured)
    error, far = {}, {}
    for loss in KINDS:
        settings = Identify(loss=loss)
        estimate = estimate_parameters(loaded.model, measured, settings, registered)
        sigma = np.sqrt(np.diag(estimate.covariance))
        far[loss] = np.abs(estimate.p - truth)[tight] / sigma[tight]
        predicted, true = loaded.poses(estimate.p, fresh), loaded.poses(truth, fresh)
        error[loss] = np.max(np.abs(np.swapaxes(true.rotation, 1, 2) @ predicted.rotation - np.eye(3)))
        if loss != "gaussian":
            found = summarise(loaded.model, measured, estimate, registered, settings)
            assert [o.pose for o in found.outliers] == wrong
            assert chi2.ppf(1e-4, found.degrees_of_freedom) < found.chi_square
            assert found.chi_square < chi2.ppf(1 - 1e-4, found.degrees_of_freedom)
            assert not any("geometry alone" in text for text in found.findings)
    for loss in ROBUST:
        assert far[loss].max() < 4
        assert np.mean(far[loss] ** 2) < 1.5
        assert error[loss] < 4e-5
    assert far["gaussian"].max() > 6
    assert error["gaussian"] > 1e-3
