"""What siblings hand down: a network whose outputs span their residuals, with their spread for a prior."""

import numpy as np
import pytest

from kincal.learning.inherit import inherit

JOINTS = 3


def functions(x: np.ndarray) -> np.ndarray:
    """(2, n, JOINTS): loads as gravity makes them, smooth and coupled."""
    return np.stack([np.sin(x) + 1, x[:, [1, 2, 0]] + 0.5 * x * x[:, [1, 2, 0]]])


def siblings(x: np.ndarray, count: int, seed: int = 0, sizes=(1.0, 1.0, 1.0)) -> np.ndarray:
    mixed = np.random.default_rng(seed).normal(size=(count, 2))
    return np.einsum("sf,fnk->snk", mixed, functions(x)) * np.array(sizes)


def inputs(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (n, JOINTS))


@pytest.fixture(scope="module")
def inherited():
    x = inputs(300)
    return inherit(x, siblings(x, 24), hidden=12, iterations=600, seed=0)


def test_a_function_in_the_siblings_span_is_reproduced(inherited):
    """Another sibling, fitted by least squares in the network's outputs on 60 poses, tried on others: to 10 %."""
    x, fresh = inputs(60, 1), inputs(300, 2)
    network = inherited[0].network
    for seed in range(5):
        known, wanted = siblings(x, 1, 100 + seed)[0], siblings(fresh, 1, 100 + seed)[0]
        weights = np.linalg.lstsq(network(x), known, rcond=None)[0]
        assert np.sqrt(np.mean((network(fresh) @ weights - wanted) ** 2) / np.mean(wanted**2)) < 0.1


def test_a_function_outside_their_span_is_not(inherited):
    network, fresh = inherited[0].network, inputs(300, 2)
    wanted = np.sin(9 * fresh)
    weights = np.linalg.lstsq(network(fresh), wanted, rcond=None)[0]
    assert np.mean((network(fresh) @ weights - wanted) ** 2) > 0.5 * np.mean(wanted**2)


def test_the_spread_is_the_siblings(inherited):
    """Each joint's residuals have unit size: so have the network's functions times their coefficients' spread."""
    found = inherited[0]
    y = found.network(inputs(2000, 3))
    assert found.spread.shape == (y.shape[1], JOINTS)
    np.testing.assert_allclose(np.mean(y**2, axis=0) @ found.spread**2, 1.0, rtol=0.1)


@pytest.mark.parametrize("sizes", [(1.0, 1e-6, 1e3)])
def test_joints_of_another_unit_count_as_much(inherited, sizes):
    """Revolute and prismatic joints of one robot: sizes are taken off."""
    x = inputs(300)
    other, _ = inherit(x, siblings(x, 24, sizes=sizes), hidden=12, iterations=5, seed=0)
    first, _ = inherit(x, siblings(x, 24), hidden=12, iterations=5, seed=0)
    np.testing.assert_allclose(other.spread, first.spread, rtol=1e-6)


def test_the_training_curve_falls(inherited):
    curve = inherited[1]
    assert curve.shape == (600, 2)
    assert curve[-1, 0] < 0.01 * curve[0, 0]


def test_twice_the_same():
    x = inputs(100)
    one, other = (inherit(x, siblings(x, 6), hidden=4, iterations=20, seed=3)[0] for _ in "ab")
    np.testing.assert_array_equal(one.network.weights, other.network.weights)


def test_a_joint_that_never_gives():
    """As the turntable of a robot that stands upright: numbers, and nothing is inherited there."""
    x = inputs(60)
    found, _ = inherit(x, siblings(x, 6, sizes=(1.0, 0.0, 1.0)), hidden=4, iterations=20, seed=0)
    assert np.isfinite(found.network.weights).all()
    assert np.all(found.spread[:, 1] < 1e-9)
    noise = siblings(x, 6, sizes=(1.0, 1e-17, 1.0))
    assert np.abs(inherit(x, noise, hidden=4, iterations=5, seed=0)[0].spread[:, 1]).max() < 1e-6


def test_siblings_that_never_give():
    """No gravity along any actuator: nothing to inherit, and no NaN."""
    x = inputs(60)
    found, _ = inherit(x, np.zeros((6, 60, JOINTS)), hidden=4, iterations=20, seed=0)
    assert np.isfinite(found.network.weights).all()
    assert np.all(found.network(x) @ found.spread == 0)
