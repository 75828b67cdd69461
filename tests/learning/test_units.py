"""The residual network's units and its value: whom they move, where they are, the hull and the way out of it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kincal.learning.correction import Correction, Hull, Spread
from kincal.learning.network import Network, initial_weights
from kincal.learning.units import GROUPS, Inherited, Own, Shared, Units, Waves, range_of

JOINTS = 3
MARGIN = 0.4  # in scaled inputs: a fifth of a range, which is 2 wide
LOW, HIGH = np.array([0.4, 0.35, -1.0]), np.array([0.6, 0.55, 2.0])  # ranges of different size


def joints(n: int, seed: int, beyond: float = 0.0) -> np.ndarray:
    span = HIGH - LOW
    return LOW - beyond * span + (1 + 2 * beyond) * span * np.random.default_rng([seed, 1]).random((n, JOINTS))


def inherited() -> Inherited:
    sizes = (JOINTS, 4, 4, 2)
    weights = initial_weights(sizes, np.random.default_rng(3))
    network = Network(sizes, weights, (LOW + HIGH) / 2, (HIGH - LOW) / 2, np.ones(2))
    return Inherited(network, np.array([[1.0, 2.0, 0.0], [0.5, 0.1, 0.3]]))


def all_units() -> Units:
    waves = Waves(np.array([[1, 2.5], [2, 7.0], [1, 4.1]]))
    return Units((LOW + HIGH) / 2, (HIGH - LOW) / 2, (Own(5), waves, Shared.random(JOINTS, 4, 0), inherited()))


@pytest.fixture
def correction() -> Correction:
    """With weights of all groups, for x in LOW .. HIGH."""
    units, random = all_units(), np.random.default_rng(1)
    readout = random.normal(size=len(units.layout[0]))
    spread = Spread(np.eye(2), np.eye(2), 0.0, 1.0)
    hull = Hull.of(units.scaled(joints(500, seed=0)))
    scale = np.array([1e-4, 2e-3, 5e-5])
    return Correction(units, readout, scale, hull, "all", 0.7, 5.0, {}, spread, spread)


# Units


def test_every_weight_has_a_unit_a_joint_and_a_name():
    units = all_units()
    joint, names = units.layout
    assert units.values(joints(7, 1)).shape == (7, len(joint)) == (7, len(names))
    counted = {name: names.count(name) for name in dict.fromkeys(names)}
    assert counted == {Own.name: 5 * JOINTS, Waves.name: 2 * 3, Shared.name: 4 * JOINTS, Inherited.name: 2 * JOINTS}
    assert list(counted) == [kind.name for kind in GROUPS]
    assert list(joint[np.array(names) == Waves.name]) == [1, 1, 2, 2, 1, 1]


@pytest.mark.parametrize(
    "name, coupled", [(Own.name, False), (Waves.name, False), (Shared.name, True), (Inherited.name, True)]
)
def test_whom_units_see_and_move(correction, central_difference, name, coupled):
    """Derivatives of each output by each input: of joint-wise groups the diagonal alone."""
    _, names = correction.units.layout
    one = replace(correction, readout=np.where([n == name for n in names], correction.readout, 0.0))
    at = joints(8, seed=2)
    jacobian = np.stack([central_difference(one, x, 1e-5) for x in at]) / one.scale[:, None] * one.units.span
    largest, moved = (
        np.abs(jacobian).max(axis=0),
        [0, 1, 2] if name in (Own.name, Shared.name, Inherited.name) else [1, 2],
    )
    assert largest[moved, moved].min() > 1e-2
    off = largest[~np.eye(JOINTS, dtype=bool)]
    assert (off.min() > 1e-3) if coupled else (off.max() < 1e-9)


def test_it_is_linear_in_its_weights(correction):
    """by_weights against unit steps of each weight; and times the weights it is the output."""
    x = joints(6, seed=3)
    slope = correction.by_weights(x)
    np.testing.assert_allclose(slope @ correction.readout, correction(x), rtol=1e-13, atol=0)
    zero = replace(correction, readout=np.zeros_like(correction.readout))
    assert np.all(zero(x) == 0)
    for k in range(len(correction.readout)):
        step = np.eye(len(correction.readout))[k]
        np.testing.assert_allclose(replace(correction, readout=step)(x), slope[:, :, k], rtol=1e-13, atol=0)


def test_a_wave_has_its_period():
    """By its definition: so many cycles over the range; sine and cosine, so any phase."""
    units = all_units().only([Waves])
    x = joints(20, seed=4)
    values = units.values(x)
    for k, (joint, cycles) in enumerate(units.groups[0].periodic):
        period = (HIGH - LOW)[int(joint)] / cycles
        moved = x.copy()
        moved[:, int(joint)] += period
        np.testing.assert_allclose(units.values(moved)[:, 2 * k : 2 * k + 2], values[:, 2 * k : 2 * k + 2], atol=1e-12)
        np.testing.assert_allclose(np.hypot(*values[:, 2 * k : 2 * k + 2].T), 1.0)
        half = x.copy()
        half[:, int(joint)] += period / 2
        np.testing.assert_allclose(units.values(half)[:, 2 * k], -values[:, 2 * k], atol=1e-12)


def test_waves_are_told_in_readings(correction):
    """Period and amplitude of the function itself, of the correction as far as it is believed; the largest first."""
    _, names = correction.units.layout
    (waves,) = correction.units.only([Waves]).groups
    largest_first = correction.waves()
    assert sorted(amplitude for *_, amplitude in largest_first)[::-1] == [amplitude for *_, amplitude in largest_first]
    for joint, period, amplitude in largest_first:
        periods = [(HIGH - LOW)[int(j)] / c if j == joint else 0.0 for j, c in waves.periodic]
        k = int(np.argmin(np.abs(np.array(periods) - period)))
        assert periods[k] == pytest.approx(period, rel=1e-12)
        pairs = np.flatnonzero([n == Waves.name for n in names]).reshape(-1, 2)[k]
        own = np.isin(np.arange(len(names)), pairs)
        one = replace(correction, readout=np.where(own, correction.readout, 0.0))
        x = np.tile((LOW + HIGH) / 2, (4000, 1))
        x[:, joint] += np.linspace(0, period, 4000)
        assert np.abs(one(x)[:, joint]).max() * correction.shrinkage == pytest.approx(amplitude, rel=1e-5)


def test_no_units_at_all():
    empty = Units((LOW + HIGH) / 2, (HIGH - LOW) / 2, ())
    assert empty.values(joints(4, 0)).shape == (4, 0) == (4, len(empty.layout[0]))


def test_one_radial_unit_a_joint():
    """No distance between centres: the reach is its width."""
    one = Units((LOW + HIGH) / 2, (HIGH - LOW) / 2, (Own(1),))
    values = one.values(joints(50, 0))
    assert np.isfinite(values).all()
    assert values.shape == (50, JOINTS)
    assert np.ptp(values) > 0.1


@given(count=st.integers(1, 30), seed=st.integers(0, 20), k=st.integers(1, 6))
def test_shared_units_bend_within_the_range(count, seed, k):
    """The hyperplane where a unit is steepest is no farther from the middle than one unit of its scaled inputs."""
    units = Shared.random(k, count, seed).hidden
    assert units.shape == (count, k + 1)
    np.testing.assert_array_equal(units, Shared.random(k, count, seed).hidden)
    assert np.all(np.abs(units[:, -1]) <= np.linalg.norm(units[:, :-1], axis=1))


@pytest.mark.parametrize("still", [0, 1, 2])
def test_range_of_a_joint_that_never_moves(still):
    x = joints(10, 0)
    x[:, still] = 0.123
    centre, span = range_of(x)
    assert span[still] == 1.0
    assert centre[still] == pytest.approx(0.123)
    moved = np.arange(JOINTS) != still
    np.testing.assert_allclose(centre[moved] + span[moved], x.max(axis=0)[moved], rtol=1e-12)
    np.testing.assert_allclose(centre[moved] - span[moved], x.min(axis=0)[moved], rtol=1e-12)


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


@pytest.mark.parametrize("direction", [[1, 0, 0], [0, -1, 0], [0.7, 0.7, 0.7], [1, -1, 0.2]])
def test_fading_outside_the_hull(correction, direction):
    """Along a ray from the middle: 1 inside, 0 beyond the margin, monotone and smooth between."""
    along = np.linspace(0, 2.5, 2501)
    x = (LOW + HIGH) / 2 + along[:, None] * (HIGH - LOW) / 2 * np.array(direction)
    fade, distance = correction.fade(x), correction.hull.outside(correction.units.scaled(x))
    assert np.all(fade[distance == 0] == 1)
    assert np.all(fade[distance > MARGIN] == 0)
    between = (distance > 0.001) & (distance < 0.999 * MARGIN)
    assert np.all((fade[between] > 0) & (fade[between] < 1))
    assert np.all(np.diff(fade) <= 0)
    assert np.abs(np.diff(fade)).max() < 0.02
    assert (fade[0], fade[-1]) == (1, 0)
    np.testing.assert_array_equal(correction.share(x), correction.shrinkage * fade)


def test_fade_by_hand():
    """Half of the margin outside: (1 - 1/4)^2."""
    units = Units(np.zeros(2), np.ones(2), (Own(1),))
    hull = Hull.of(np.array([[-1.0, -1], [1, 1], [1, -1], [-1, 1]]))
    spread = Spread(np.eye(2), np.eye(2), 0.0, 1.0)
    own = Correction(units, np.ones(2), np.ones(2), hull, "", 0.4, 5.0, {}, spread, spread)
    x = np.array([[0.3, -0.2], [1 + MARGIN / 2, 0.0], [1.1 + MARGIN, 0.0]])
    np.testing.assert_allclose(own.share(x), [0.4, 0.4 * 0.5625, 0.0], rtol=1e-12)


# How sure


def test_spread_against_a_monte_carlo():
    """Covariance of predictions whose parameters, weights and outputs are drawn, 200 000 times."""
    random = np.random.default_rng(0)
    basis = np.linalg.qr(random.normal(size=(5, 3)))[0]
    root = random.normal(size=(3 + 4, 3 + 4))
    by_model, by_output, units = (random.normal(size=(2, 6, k)) for k in (5, 2, 4))
    spread = Spread(basis, root @ root.T, 0.8, 2.5)
    drawn = random.normal(size=(200_000, 7)) @ root.T
    noise = 0.8 * random.normal(size=(200_000, 2))
    for found, with_units in ((spread.of(by_model, by_output, units), True),):
        for k in range(2):
            moved = drawn[:, :3] @ (by_model[k] @ basis).T + noise @ by_output[k].T
            moved += with_units * drawn[:, 3:] @ units[k].T
            np.testing.assert_allclose(found[k], 2.5 * np.cov(moved.T), rtol=0, atol=0.02 * np.abs(found[k]).max())
    alone = Spread(basis, (root @ root.T)[:3, :3], 0.8, 2.5)
    for k, found in enumerate(alone.of(by_model, by_output, None)):
        moved = drawn[:, :3] @ (by_model[k] @ basis).T + noise @ by_output[k].T
        np.testing.assert_allclose(found, 2.5 * np.cov(moved.T), rtol=0, atol=0.02 * np.abs(found).max())
