"""D-optimal poses: the exchange against brute force and direct determinants, and the poses themselves."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.d_optimal import MAX_POSES, Design, candidates, d_optimal, log_det, select
from kincal.identification.expected import all_feasible, expected, feasible, information, of_one_row, prior_sigma
from kincal.identification.poses import planned, travel_order
from kincal.urdf.description import Instruments, Plan, Sensor, Stream, Tolerance
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import forward, tool_coordinates
from kincal.urdf.workspace import bounds, condition_numbers, sample

CASES = [
    ("ups3_s", ("orientation",)),
    ("ups3_s", ("tilt",)),
    ("jugglebot", ("orientation", "position")),
    ("ur10", ("orientation", "position")),
]


def blocks_at_random(seed: int, n: int, rows: int, k: int) -> np.ndarray:
    """Candidates (n, rows, k): columns of very different size, one of them never seen."""
    random = np.random.default_rng(seed)
    blocks = random.normal(size=(n, rows, k)) * 10.0 ** random.uniform(-2, 3, k)
    blocks[:, :, -1] = 0
    return blocks


@pytest.fixture(scope="module")
def informed(robot):
    """informed(name, channels, n) -> (Sites, blocks): the candidates of n poses, and the information in each."""
    known = {}

    def of(name: str, channels: tuple[str, ...], n: int):
        if (name, channels, n) not in known:
            loaded = robot(name)
            sites = candidates(loaded.model, loaded.description.workspace, n, 0)
            known[name, channels, n] = (sites, information(loaded.model, sites, channels, loaded.description.sensor))
        return known[name, channels, n]

    return of


# The exchange


@pytest.mark.parametrize("seed", range(6))
def test_brute_force_on_a_few_candidates(seed):
    """4 of 11: all 330 sets."""
    blocks = blocks_at_random(seed, 11, 2, 6)
    best = max(combinations(range(11), 4), key=lambda rows: log_det(blocks[list(rows)]))
    found = select(blocks, 4, restarts=8)
    assert tuple(found.rows) == best
    assert found.log_det == pytest.approx(log_det(blocks[list(best)]), abs=1e-6)


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 6), n=st.integers(1, 25), k=st.integers(2, 9))
def test_the_determinant_never_falls(seed, rows, n, k):
    """From one pass to the next; and what is said of it is that of the poses that come out, each taken once."""
    blocks = blocks_at_random(seed, 25, rows, k)
    found = select(blocks, n, seed)
    assert np.all(np.diff(found.history) >= 0)
    assert len(np.unique(found.rows)) == n
    assert found.log_det == pytest.approx(log_det(blocks[found.rows]), abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_exchange_ends_where_no_single_one_gains(seed):
    blocks = blocks_at_random(seed, 40, 3, 8)
    rows = select(blocks, 7, restarts=0).rows
    best = log_det(blocks[rows])
    for k in range(7):
        for other in np.setdiff1d(np.arange(40), rows):
            assert log_det(blocks[[*np.delete(rows, k), other]]) <= best + 1e-6


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 6), count=st.integers(2, 12))
def test_block_updates_against_direct_determinants(seed, rows, count):
    random = np.random.default_rng(seed)
    blocks = blocks_at_random(seed, 12, rows, 7)
    start = random.integers(0, 3, 12)
    start[0] = 1
    design = Design.of(blocks, start)

    def direct(counts: np.ndarray) -> float:
        return log_det(np.repeat(blocks, counts, axis=0))

    def one(row: int) -> np.ndarray:
        return np.eye(12, dtype=int)[row]

    assert design.log_det == pytest.approx(direct(start), abs=1e-8)
    added = [direct(start + one(k)) - direct(start) for k in range(12)]
    np.testing.assert_allclose(design.gains(), added, rtol=0, atol=1e-7)
    exchanged = [direct(start + one(k) - one(0)) - direct(start) for k in range(12)]
    np.testing.assert_allclose(design.gains_instead(0), exchanged, rtol=0, atol=1e-6)
    counts = start.copy()
    for _ in range(count):  # a walk of additions and removals
        row = int(random.integers(12))
        sign = -1 if counts[row] and random.random() < 0.4 else 1
        design.change(row, sign)
        counts[row] += sign
    fresh = Design.of(blocks, counts)
    assert design.log_det == pytest.approx(direct(counts), abs=1e-6)
    np.testing.assert_allclose(design.covariance, fresh.covariance, rtol=0, atol=1e-7)
    np.testing.assert_allclose(design.spread, fresh.spread, rtol=1e-6, atol=1e-6 * np.abs(fresh.spread).max())


@pytest.mark.parametrize("n", [3, 10, 13, 25])
def test_no_candidate_twice_before_each_is_taken_once(n):
    counts = np.bincount(select(blocks_at_random(1, 10, 2, 5), n).rows, minlength=10)
    assert counts.sum() == n
    assert set(counts) <= {n // 10, n // 10 + 1}


# Poses of robots


@pytest.mark.parametrize("name, channels", CASES)
@pytest.mark.parametrize("n", [4, 20])
def test_beats_random_designs_and_is_no_worse_than_the_grid(name, channels, n, robot, informed):
    """log det of the information of parameters; random: sets of the same candidates, and Sobol points."""
    loaded, (_, blocks) = robot(name), informed(name, channels, n)
    found = select(blocks, n)
    random = np.random.default_rng(0)
    drawn = [log_det(blocks[random.choice(len(blocks), n, replace=False)]) for _ in range(30)]
    assert found.log_det > max(drawn) + 1
    for layout in ("grid", "random"):
        u = planned(loaded.description.workspace, loaded.chain.tool_axes, Plan(poses=n, layout=layout), 0)
        sites = all_feasible(loaded.model, loaded.description.workspace, u, layout)
        other = log_det(information(loaded.model, sites, channels, loaded.description.sensor))
        assert found.log_det >= other, layout


@pytest.mark.parametrize("name, channels", CASES)
@pytest.mark.parametrize("n", [3, 5, 30])
def test_updates_stay_exact_where_few_poses_carry_the_frames(name, channels, n, informed):
    """Whose priors are flat: a pose that alone sees a direction has a leverage of 1, but for 1e-8."""
    blocks = informed(name, channels, 20)[1]
    found = select(blocks, n)
    assert found.log_det == pytest.approx(log_det(blocks[found.rows]), abs=1e-5)
    assert np.all(np.diff(found.history) >= 0)


def test_what_tilt_alone_never_sees_changes_nothing(informed, robot):
    """W's turn about gravity, and all translations of T and W, have columns of zeros."""
    blocks = informed("ups3_s", ("tilt",), 20)[1]
    names = robot("ups3_s").model.parameters.names
    unseen = [k for k, name in enumerate(names) if name in ("instrument.rz", "target.x", "target.y", "target.z")]
    assert np.abs(blocks[:, :, unseen]).max() < 1e-9 * np.abs(blocks).max()
    found, without = select(blocks, 12), select(np.delete(blocks, unseen, axis=2), 12)
    np.testing.assert_array_equal(found.rows, without.rows)
    assert found.log_det == pytest.approx(without.log_det, abs=1e-6)


@pytest.mark.parametrize("name, channels", CASES)
def test_poses_are_feasible_and_deterministic(name, channels, robot):
    loaded = robot(name)
    chain, workspace, sensor = loaded.chain, loaded.description.workspace, loaded.description.sensor
    sites = d_optimal(loaded.model, workspace, channels, sensor, 15, 0)
    assert len(np.unique(sites.u.round(9), axis=0)) == 15
    axes = list(chain.tool_axes)
    low, high = bounds(workspace).T
    assert np.all((sites.u[:, axes] >= low - 1e-12) & (sites.u[:, axes] <= high + 1e-12))
    assert np.all((sites.q >= chain.lower - 1e-9) & (sites.q <= chain.upper + 1e-9))
    assert condition_numbers(chain, sites.q).max() <= workspace.max_condition
    closure = forward(chain, loaded.model.actuators.joints(sites.readings))
    assert closure.closed.all()
    np.testing.assert_allclose(tool_coordinates(chain, closure.pose)[:, axes], sites.u[:, axes], rtol=0, atol=1e-9)
    again = d_optimal(loaded.model, workspace, channels, sensor, 15, 0)
    np.testing.assert_array_equal(again.readings, sites.readings)
    assert not np.array_equal(d_optimal(loaded.model, workspace, channels, sensor, 15, 1).u, sites.u)


def test_infeasible_candidates_are_dropped(robot):
    """Joint limits that cut the workspace, then a condition number that does."""
    loaded = robot("ups3_s")
    chain, workspace, sensor = loaded.chain, loaded.description.workspace, loaded.description.sensor
    slides = chain.actuated
    upper = chain.upper.copy()
    upper[slides] = chain.home[slides] + 0.05
    narrow = replace(loaded.model, chain=replace(chain, upper=upper))
    sites = d_optimal(narrow, workspace, ("orientation",), sensor, 10, 0)
    assert sites.q[:, slides].max() <= upper[slides].min() + 1e-9
    whole = candidates(loaded.model, workspace, 10, 0)
    assert 100 < len(candidates(narrow, workspace, 10, 0)) < 0.8 * len(whole)
    numbers = condition_numbers(chain, whole.q)
    mild = workspace.model_copy(update={"max_condition": float(np.median(numbers))})
    sites = d_optimal(loaded.model, mild, ("orientation",), sensor, 10, 0)
    assert condition_numbers(chain, sites.q).max() <= mild.max_condition


def test_too_few_feasible_candidates(robot):
    loaded = robot("ups3_s")
    model = replace(loaded.model, chain=replace(loaded.chain, upper=loaded.chain.home, lower=loaded.chain.home))
    with pytest.raises(InputError, match=r"plan: 1 of \d+ candidate poses are .* at least 3 are needed"):
        candidates(model, loaded.description.workspace, 10, 0)


@pytest.mark.parametrize("n", [0, 2, MAX_POSES + 1])
def test_numbers_that_are_refused(n, robot):
    loaded = robot("ups3_s")
    with pytest.raises(InputError, match=rf"plan: {n} poses; allowed are 3 .* to {MAX_POSES}"):
        d_optimal(loaded.model, loaded.description.workspace, ("orientation",), Sensor(), n, 0)


def test_poses_that_are_not_feasible_are_named(robot):
    loaded = robot("ups3_s")
    u = np.zeros((3, 6))
    u[1, 3] = np.deg2rad(80)
    with pytest.raises(InputError, match="planned: pose 1"):
        all_feasible(loaded.model, loaded.description.workspace, u, "planned")
    sites, good = feasible(loaded.model, loaded.description.workspace, u)
    assert list(good) == [True, False, True]
    np.testing.assert_array_equal(sites.u, u[[0, 2]])


def test_planned_refuses_the_layout_that_needs_a_model(robot):
    loaded = robot("ups3_s")
    with pytest.raises(ValueError, match="d_optimal"):
        planned(loaded.description.workspace, loaded.chain.tool_axes, Plan(layout="d_optimal"), 0)


# What is expected before it is measured


@pytest.mark.parametrize("name, channels", [*CASES, ("jugglebot", ("tilt", "yaw", "position"))])
def test_expected_measurements_are_those_without_noise(name, channels, robot):
    loaded = robot(name)
    p, readings = loaded.random_parameters(3), loaded.readings(6, 3)
    sensor = Sensor(orientation_deg=0.3, position_mm=2.0, tilt_deg=0.1, yaw_deg=0.2)
    q = loaded.model.robot(p).close(readings).q
    found = expected(loaded.model, p, readings, q, channels, sensor)
    assert set(found.channels) == set(channels)
    residual = loaded.model.residual(loaded.model.robot(p), q, found)
    np.testing.assert_allclose(residual, 0, rtol=0, atol=1e-7)
    sizes = {"orientation": np.deg2rad(0.3), "position": 2e-3, "tilt": np.deg2rad(0.1), "yaw": np.deg2rad(0.2)}
    for channel in channels:
        np.testing.assert_allclose(found.std[channel], sizes[channel], rtol=1e-12)
    plain = loaded.measure(p, readings, channels, {c: sizes[c] for c in channels})
    np.testing.assert_allclose(
        loaded.model.jacobian(p, found, q), loaded.model.jacobian(p, plain, q), rtol=1e-8, atol=1e-6
    )


def test_information_is_the_gauss_newton_matrix_in_prior_units(robot):
    """Twice the tolerances: twice the information's root, but for W and T; half the sensor's sigma: twice."""
    loaded = robot("ups3_s")
    u = sample(loaded.description.workspace, loaded.chain.tool_axes, 4, 1)
    sites, _ = feasible(loaded.model, loaded.description.workspace, u)
    blocks = information(loaded.model, sites, ("orientation",), Sensor(orientation_deg=0.01))
    finer = information(loaded.model, sites, ("orientation",), Sensor(orientation_deg=0.005))
    np.testing.assert_allclose(finer, 2 * blocks, rtol=1e-9, atol=1e-9)
    parameters = replace(loaded.model.parameters, tolerance=2 * loaded.model.parameters.tolerance)
    wider = information(replace(loaded.model, parameters=parameters), sites, ("orientation",), Sensor())
    sharp = information(loaded.model, sites, ("orientation",), Sensor())
    np.testing.assert_allclose(wider[:, :, :-12], 2 * sharp[:, :, :-12], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(wider[:, :, -12:], sharp[:, :, -12:], rtol=1e-9, atol=1e-9)
    assert np.all(np.isfinite(prior_sigma(parameters)))


def test_a_row_of_a_stream_is_the_mean_of_its_samples():
    sensor = Sensor(tilt_deg=0.01, yaw_deg=0.02, orientation_deg=0.5)
    stream = Stream(rate_hz=50, seconds=8, dropouts=0.0, outliers=0.0)
    known = {"sensor": sensor, "tolerance": Tolerance()}
    channels, row = of_one_row(Instruments(channels=("tilt", "yaw"), stream=stream, **known), (3, 4, 5))
    assert channels == ("tilt", "yaw")
    assert (row.tilt_deg, row.yaw_deg) == pytest.approx((0.01 / 20, 0.02 / 20))
    assert row.orientation_deg == 0.5
    assert of_one_row(Instruments(channels=("tilt",), stream=None, **known), (3, 4, 5))[1] == sensor
    assert of_one_row(Instruments(channels=None, stream=stream, **known), (0, 5)) == (
        ("orientation", "position"),
        sensor,
    )


# The order in which the machine visits them


def travelled(joints: np.ndarray, home: np.ndarray) -> float:
    """The sum of each move's longest joint, in units of its range."""
    route = np.concatenate([home[None], joints])
    return float(np.abs(np.diff(route, axis=0) / np.ptp(route, axis=0)).max(axis=1).sum())


@given(seed=st.integers(0, 10_000), n=st.integers(1, 40), k=st.integers(1, 6))
def test_the_travel_is_no_longer_than_by_nearest_neighbours(seed, n, k):
    random = np.random.default_rng(seed)
    joints, home = random.normal(size=(n, k)) * 10.0 ** random.uniform(-2, 2, k), np.zeros(k)
    order = travel_order(joints, home)
    assert sorted(order) == list(range(n))
    scale, left, greedy = np.ptp(np.concatenate([home[None], joints]), axis=0), list(range(n)), []
    while left:
        here = joints[greedy[-1]] if greedy else home
        greedy.append(min(left, key=lambda row: np.max(np.abs(joints[row] - here) / scale)))
        left.remove(greedy[-1])
    assert travelled(joints[order], home) <= travelled(joints[greedy], home) + 1e-9


def test_travel_along_a_line_and_of_equal_poses():
    values = np.array([3.0, 1.0, 4.0, 2.0, 5.0])
    assert list(values[travel_order(values[:, None], np.zeros(1))]) == [1, 2, 3, 4, 5]
    assert sorted(travel_order(np.ones((4, 2)), np.ones(2))) == [0, 1, 2, 3]
