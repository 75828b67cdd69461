"""Which poses to measure and to hold out: the paper's grids, and what a partition is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.poses import chosen, equal_parts, folds, held_out, planned
from kincal.urdf.description import Plan, Split
from kincal.urdf.errors import InputError
from kincal.urdf.workspace import grid


def poses(loaded, n: int, seed: int = 0, layout=None) -> np.ndarray:
    return planned(loaded.description.workspace, loaded.chain.tool_axes, Plan(poses=n, layout=layout), seed)


@pytest.mark.parametrize("n, counts", [(150, (5, 5, 6)), (216, (6, 6, 6)), (27, (3, 3, 3)), (8, (2, 2, 2))])
def test_grids_of_the_paper(n, counts, robot):
    """Each axis has its count of equidistant angles, and every combination is there once."""
    u = poses(robot("ups3_s"), n)
    assert u.shape == (n, 6)
    assert len(np.unique(u.round(12), axis=0)) == n
    for axis, count, limit in zip((3, 4, 5), counts, (20, 20, 10), strict=True):
        angles = np.unique(u[:, axis].round(12))
        np.testing.assert_allclose(np.rad2deg(angles), np.linspace(-limit, limit, count), rtol=0, atol=1e-8)
    assert np.all(u[:, :3] == 0)


@pytest.mark.parametrize("n, side", [(10, 3), (20, 3), (110, 5), (210, 6)])
def test_other_numbers_are_drawn_from_a_cubic_grid(n, side, robot):
    """The paper's study of n: without repetition, from the smallest cubic grid that holds them."""
    loaded = robot("ups3_s")
    u = poses(loaded, n)
    whole = grid(loaded.description.workspace, loaded.chain.tool_axes, [side] * 3)
    assert len(np.unique(u.round(12), axis=0)) == n
    assert {tuple(row) for row in u.round(12)} <= {tuple(row) for row in whole.round(12)}
    np.testing.assert_array_equal(u, poses(loaded, n))
    assert not np.array_equal(u, poses(loaded, n, seed=1))


def test_six_axes_are_filled_evenly_instead(robot):
    loaded = robot("ur10")
    u = poses(loaded, 150)
    assert len(np.unique(u[:, 0].round(12))) == 150
    assert np.all(np.std(u, axis=0) > 0)
    np.testing.assert_array_equal(u, poses(loaded, 150, layout="random"))


@given(n=st.integers(4, 400), test=st.floats(0.01, 0.7), seed=st.integers(0, 2**31))
def test_held_out_rows_are_a_proper_part(n, test, seed):
    k = max(1, round(test * n))
    if n - k < 3:
        with pytest.raises(InputError, match=r"split\.test"):
            held_out(n, Split(test=test), seed)
        return
    rows = held_out(n, Split(test=test), seed)
    assert len(rows) == k
    assert np.all(np.diff(rows) > 0)
    assert rows.min() >= 0
    assert rows.max() < n
    np.testing.assert_array_equal(rows, held_out(n, Split(test=test), seed))


@given(n=st.integers(4, 400), test=st.floats(0.01, 0.7), seed=st.integers(0, 2**31))
def test_folds_are_a_partition(n, test, seed):
    """Every pose in one fold; sizes differ by one at most."""
    parts = folds(n, Split(test=test), seed)
    assert len(parts) == min(n, max(2, round(1 / test)))
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(n))
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    assert min(sizes) >= 1


def test_too_few_poses_to_hold_any_out():
    for n in (1, 2, 3):
        with pytest.raises(InputError, match=rf"measurements: {n} poses less 1 .* at least 3"):
            held_out(n, Split(), 0)
    assert len(held_out(4, Split(), 0)) == 1


def test_seeds_give_different_parts():
    drawn = {tuple(held_out(50, Split(), seed)) for seed in range(20)}
    assert len(drawn) == 20


# [split] poses


@given(n=st.integers(1, 200), seed=st.integers(0, 50), data=st.data())
def test_fewer_poses_are_among_more(n, seed, data):
    """Each row once, in order, and nested: a curve over their number adds poses and takes none away."""
    few = data.draw(st.integers(1, n))
    more = data.draw(st.integers(few, n))
    one, other = chosen(n, few, seed), chosen(n, more, seed)
    assert (len(one), len(other)) == (few, more)
    assert set(one) <= set(other) <= set(range(n))
    assert np.all(np.diff(other) > 0)
    np.testing.assert_array_equal(chosen(n, n, seed), np.arange(n))


def test_another_seed_chooses_others():
    assert set(chosen(100, 20, 0)) != set(chosen(100, 20, 1))


def test_more_poses_than_there_are():
    with pytest.raises(InputError, match=r"split\.poses = 13: there are 12 measured poses"):
        chosen(12, 13, 0)


@given(n=st.integers(1, 60), seed=st.integers(0, 20), data=st.data())
def test_equal_parts(n, seed, data):
    """Every row in one of them, and none larger than another by more than one."""
    k = data.draw(st.integers(1, n))
    parts = equal_parts(n, k, seed)
    assert len(parts) == k
    assert sorted(np.concatenate(parts)) == list(range(n))
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
