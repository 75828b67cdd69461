"""The correction on synthetic errors: what is there is learned, noise is not, and outside the hull it fades."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learning.network import Layout, Network, initial_weights
from learning.residual import Correction, Hull, fit_correction

JOINTS = 3
LOW, HIGH = np.array([0.4, 0.35, 0.5]), np.array([0.6, 0.55, 0.52])  # ranges of different size
SIGMA = 1e-5


def joints(n: int, seed: int) -> np.ndarray:
    return LOW + (HIGH - LOW) * np.random.default_rng([seed, 1]).random((n, JOINTS))


def delta(x: np.ndarray) -> np.ndarray:
    """A smooth error of each joint, and a load that couples them."""
    u = 2 * (x - LOW) / (HIGH - LOW) - 1
    return 3e-4 * (np.sin(2 * u) + 0.5 * u**2) + 1e-4 * (u[:, [1, 2, 0]] * u[:, [2, 0, 1]])


def gain(x: np.ndarray) -> np.ndarray:
    """(n, 4, 3): four errors a pose by three joints, whitened with SIGMA; it varies over the workspace."""
    u = 2 * (x - LOW) / (HIGH - LOW) - 1
    base = np.random.default_rng(7).normal(size=(4, JOINTS))
    return (base + 0.2 * np.sin(u)[:, None, :]) / SIGMA


def fitted(n: int, seed: int, size: float, iterations: int = 20) -> Correction:
    """A correction fitted to errors r = -J delta + noise of one sigma: r + J delta(x) is noise alone."""
    x = joints(n, seed)
    error = -np.einsum("nmk,nk->nm", gain(x), size * delta(x)) + np.random.default_rng(seed).normal(size=(n, 4))
    folds = np.array_split(np.random.default_rng([seed, 2]).permutation(n), min(5, n))
    unseen = np.repeat(error[None], len(folds), axis=0)
    options = {"own": 4, "shared": 4, "iterations": iterations, "seed": seed}
    return fit_correction(x, error, gain(x), folds, unseen, **options)


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def learned() -> Correction:
    return fitted(120, seed=1, size=1.0)


def test_a_smooth_delta_is_found(learned):
    """Against the known function on fresh joints: the error falls to less than a fifth."""
    x = joints(500, seed=99)
    inside = learned.fade(x) == 1.0
    assert inside.mean() > 0.8
    left = root_mean_square(learned(x[inside]) - delta(x[inside]))
    assert left < 0.2 * root_mean_square(delta(x[inside]))
    assert 0.9 <= learned.shrinkage <= 1.0
    assert learned.gain_of_evidence > 5


def test_twice_the_same(learned):
    """Deterministic to the last bit."""
    again = fitted(120, seed=1, size=1.0)
    np.testing.assert_array_equal(again.network.weights, learned.network.weights)
    assert (again.shrinkage, again.decay) == (learned.shrinkage, learned.decay)


def test_the_unit_of_the_errors_does_not_matter(learned):
    """Errors and gains in units a thousand times as large: the same function of the joints."""
    x = joints(120, seed=1)
    error = -np.einsum("nmk,nk->nm", gain(x), delta(x)) + np.random.default_rng(1).normal(size=(120, 4))
    folds = np.array_split(np.random.default_rng([1, 2]).permutation(120), 5)
    unseen = np.repeat(1e3 * error[None], 5, axis=0)
    options = {"own": 4, "shared": 4, "iterations": 20, "seed": 1}
    other = fit_correction(x, 1e3 * error, 1e3 * gain(x), folds, unseen, **options)
    np.testing.assert_allclose(other(x), learned(x), rtol=0, atol=1e-3 * root_mean_square(delta(x)))


def test_noise_is_not_learned():
    """Nothing to learn: exactly zero in at least nine of ten seeds, and never more than a tenth of real errors."""
    x = joints(200, seed=99)
    found = [fitted(40, seed, size=0.0, iterations=10) for seed in range(10)]
    assert sum(correction.shrinkage == 0.0 for correction in found) >= 9
    for correction in found:
        assert root_mean_square(correction(x)) < 0.1 * root_mean_square(delta(x))
        assert correction.shrinkage > 0 or np.all(correction(x) == 0.0)


@pytest.mark.parametrize("n", [3, 5])
@pytest.mark.parametrize("size", [0.0, 1.0])
def test_a_handful_of_poses_gives_finite_corrections(n, size):
    """No crash; and noise of so few poses gives nothing."""
    found = fitted(n, seed=0, size=size, iterations=5)
    assert np.isfinite(found(joints(50, seed=3))).all()
    if size == 0.0:
        assert found.shrinkage == 0.0


# The hull


POINTS = st.integers(1, 12).flatmap(
    lambda n: st.integers(1, 5).flatmap(lambda k: arrays(float, (n, k), elements=st.floats(-1, 1)))
)


@given(points=POINTS, seed=st.integers(0, 9))
def test_the_hull_holds_its_points_and_what_lies_between(points, seed):
    """All points, and random mixtures of them (their convex hull), lie inside but for rounding."""
    hull = Hull.of(points)
    np.testing.assert_allclose(hull.outside(points), 0, atol=1e-15)
    mixed = np.random.default_rng(seed).dirichlet(np.ones(len(points)), 20) @ points
    np.testing.assert_allclose(hull.outside(mixed), 0, atol=1e-12)


def test_distance_from_the_hull():
    """A diamond by hand: its corners at 1 on the axes, its faces the square root of a half from the middle."""
    hull = Hull.of(np.array([[-1.0, 0], [1, 0], [0, -1], [0, 1]]))
    distance = hull.outside(np.array([[0.0, 0], [1.5, 0], [0, -3], [1, 1], [0.5, 0.5]]))
    np.testing.assert_allclose(distance, [0, 0.5, 2, np.sqrt(0.5), 0], atol=1e-12)


def test_fading_outside_the_hull(learned):
    """Along a ray from the middle: 1 inside, 0 beyond a tenth of the range, monotone and smooth between."""
    middle = (LOW + HIGH) / 2
    along = np.linspace(0, 2.0, 2001)
    for direction in ([1, 0, 0], [0, -1, 0], [0.7, 0.7, 0.7], [1, -1, 0.2]):
        x = middle + along[:, None] * (HIGH - LOW) / 2 * np.array(direction)
        fade, distance = learned.fade(x), learned.hull.outside(learned.network.scaled(x))
        assert np.all(fade[distance == 0] == 1)
        assert np.all(fade[distance > 0.2] == 0)  # a range is 2 wide
        assert np.all(
            (fade[(distance > 0) & (distance < 0.199)] > 0) & (fade[(distance > 0) & (distance < 0.199)] <= 1)
        )
        assert np.all(np.diff(fade) <= 0)
        assert np.abs(np.diff(fade)).max() < 0.02
        assert fade[0] == 1
        assert fade[-1] == 0
        np.testing.assert_array_equal(learned(x)[distance > 0.2], 0)


def test_shrinkage_and_fade_are_factors():
    """Against the definition: shrinkage * fade * network."""
    layout = Layout.joint_wise(2, 2, 2)
    weights = initial_weights(layout, np.random.default_rng(0))
    network = Network(layout.sizes, weights, np.zeros(2), np.ones(2), np.ones(2))
    correction = Correction(network, Hull.of(np.array([[-1.0, -1], [1, 1], [1, -1], [-1, 1]])), 0.4, 1.0, 3.0)
    x = np.array([[0.3, -0.2], [1.1, 0.0], [1.3, 0.0]])
    fades = np.array([1.0, (1 - 0.5**2) ** 2, 0.0])  # half of the margin of 0.2 outside
    np.testing.assert_allclose(correction(x), 0.4 * fades[:, None] * network(x), rtol=1e-12)
