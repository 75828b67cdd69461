"""Periodic errors: planted ones are found, and nothing is found in noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as profile
from hypothesis import strategies as st

from kincal.learning.waves import find_waves

JOINTS, ROWS = 3, 3


def problem(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Inputs, noise of one sigma, columns of a model (constant and linear in the inputs), and d error / d output."""
    random = np.random.default_rng([seed, 3])
    x = random.uniform(-1, 1, (n, JOINTS))
    gain = random.normal(size=(ROWS, JOINTS)) + 0.3 * np.sin(x)[:, None, :]
    smooth = np.concatenate([np.ones((n, 1)), x], axis=1)
    columns = 20 * gain[:, :, :, None] * smooth[:, None, None, :]
    return x, random.normal(size=(n, ROWS)), columns.reshape(n, ROWS, -1), gain


def planted(x: np.ndarray, gain: np.ndarray, joint: int, cycles: float, amplitude: float, phase: float) -> np.ndarray:
    return gain[:, :, joint] * amplitude * np.sin(np.pi * cycles * (x[:, [joint]] + 1) + phase)


@profile(max_examples=25)
@given(
    joint=st.integers(0, JOINTS - 1),
    cycles=st.floats(1.5, 40.0),
    phase=st.floats(0, 2 * np.pi),
    amplitude=st.floats(2.0, 50.0),
    seed=st.integers(0, 99),
)
def test_a_planted_wave_is_found(joint, cycles, phase, amplitude, seed):
    """The strongest is of the right joint and period, to half the step between two that are tried."""
    x, noise, columns, gain = problem(150, seed)
    found = find_waves(x, noise + planted(x, gain, joint, cycles, amplitude, phase), columns, gain)
    assert found.shape[1:] == (2,)
    assert found[0, 0] == joint
    assert abs(found[0, 1] - cycles) <= 0.1


def test_several_waves_are_found():
    """Two of one joint and one of another; no other joint is blamed."""
    x, noise, columns, gain = problem(200, 1)
    true = [(0, 3.1, 8.0), (0, 9.5, 5.0), (2, 6.3, 3.0)]
    error = noise + sum(planted(x, gain, j, c, a, 0.4) for j, c, a in true)
    found = find_waves(x, error, columns, gain)
    for joint, cycles, _ in true:
        assert np.min(np.abs(found[found[:, 0] == joint, 1] - cycles)) <= 0.05
    assert set(found[:, 0]) == {0.0, 2.0}


def test_strongest_first():
    x, noise, columns, gain = problem(200, 2)
    error = noise + planted(x, gain, 1, 4.0, 3.0, 0.1) + planted(x, gain, 2, 7.0, 9.0, 0.1)
    np.testing.assert_array_equal(find_waves(x, error, columns, gain)[:2, 0], [2, 1])


@pytest.mark.parametrize("n", [50, 150])
def test_nothing_in_noise(n):
    """A false alarm in a thousand robots is meant: of sixty at most two, and the seeds are fixed."""
    alarms = 0
    for seed in range(60):
        x, noise, columns, gain = problem(n, seed)
        alarms += len(find_waves(x, noise, columns, gain)) > 0
    assert alarms <= 2


def test_what_the_model_explains_is_no_wave():
    """Errors linear in the inputs, a thousand times the noise."""
    x, noise, columns, gain = problem(100, 4)
    error = noise + columns @ np.random.default_rng(0).normal(size=columns.shape[2])
    assert np.abs(error).max() > 50
    assert find_waves(x, error, columns, gain).shape == (0, 2)


@pytest.mark.parametrize("n", [3, 8, 11])
def test_too_few_poses_for_any(n):
    x, noise, columns, gain = problem(n, 5)
    assert find_waves(x, noise, columns, gain).shape == (0, 2)


def test_a_joint_that_never_moves():
    """Its waves are constants: never chosen, and no number becomes none."""
    x, noise, columns, gain = problem(120, 6)
    x[:, 1] = 0.0
    found = find_waves(x, noise + planted(x, gain, 0, 5.0, 6.0, 1.0), columns, gain)
    assert np.isfinite(found).all()
    assert found[0, 0] == 0
    assert 1 not in found[:, 0]


def test_more_poses_than_are_looked_at():
    """Five thousand: the same wave, and no more."""
    x, noise, columns, gain = problem(5000, 7)
    found = find_waves(x, noise + planted(x, gain, 2, 8.2, 2.0, 0.3), columns, gain)
    assert found[0, 0] == 2
    assert abs(found[0, 1] - 8.2) <= 0.02
