"""Belsley's diagnostics against explicit regressions and numpy, on made-up matrices and on robots' Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.collinearity import collinearity
from kincal.identification.error_model import Parameters
from kincal.identification.estimators import register
from kincal.identification.identifiability import identifiability

N_FRAMES = 12  # W and T: flat


def made_up(n: int) -> Parameters:
    """n parameters of different tolerances, and W and T."""
    names = (*(f"a{k}" for k in range(n)), *(f"frame{k}" for k in range(N_FRAMES)))
    tolerance = np.concatenate([10.0 ** -(np.arange(n) % 4), np.full(N_FRAMES, np.inf)])
    return Parameters(names, ("m",) * len(names), np.zeros(len(names)), tolerance)


def left(columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """What a regression of columns (m, k) on `others` leaves."""
    scale = np.linalg.norm(others, axis=0)
    others = others[:, scale > 0] / scale[scale > 0]
    return columns - others @ np.linalg.lstsq(others, columns, rcond=1e-11)[0]


def assert_is_belsleys(jacobian: np.ndarray, parameters: Parameters, found) -> None:
    """Against the tall Jacobian (m, n_parameters) itself: regressions of each column on all others, and on W and T."""
    where = [parameters.names.index(name) for name in found.parameters]
    geometry = jacobian[:, where] * parameters.tolerance[where]
    frames = jacobian[:, -N_FRAMES:]
    alone = left(geometry, frames)
    for k, inflation in enumerate(found.inflation):
        others = np.column_stack([np.delete(geometry, k, axis=1), frames])
        rest = left(geometry[:, [k]], others)
        share = np.sum(rest**2) / np.sum(alone[:, k] ** 2)  # 1 - R^2, W and T in the intercept's part
        assert inflation == pytest.approx(1 / share, rel=1e-5)
    unit = alone / np.linalg.norm(alone, axis=0)
    assert found.condition_indexes[-1] == pytest.approx(np.linalg.cond(unit), rel=1e-6)
    eigenvalues, vectors = np.linalg.eigh(unit.T @ unit)
    order = np.argsort(-eigenvalues)
    eigenvalues, vectors = eigenvalues[order], vectors[:, order]
    np.testing.assert_allclose(found.condition_indexes, np.sqrt(eigenvalues[0] / eigenvalues), rtol=1e-4)
    np.testing.assert_allclose(found.proportions.sum(axis=0), 1.0, rtol=1e-12)
    assert found.proportions.shape == (len(where), len(where))
    if np.min(np.abs(np.diff(np.log(eigenvalues)))) > 1e-6:  # where singular vectors are unique
        variance = vectors.T**2 / eigenvalues[:, None]  # (condition index, parameter)
        np.testing.assert_allclose(found.proportions, variance / variance.sum(axis=0), rtol=1e-3, atol=1e-5)


@given(n=st.integers(2, 8), extra=st.integers(5, 40), near=st.floats(-4, 0), seed=st.integers(0, 10**6))
def test_matrices_at_random_with_two_columns_that_are_nearly_one(n, extra, near, seed):
    """Columns of any scale, two of them at an angle of about 10^near, W's and T's leaning on the first."""
    random = np.random.default_rng(seed)
    jacobian = random.normal(size=(n + N_FRAMES + extra, n + N_FRAMES))
    jacobian[:, 1] = jacobian[:, 0] + 10.0**near * jacobian[:, 1]
    jacobian[:, -1] += jacobian[:, 0]
    parameters = made_up(n)
    jacobian[:, :n] *= 10.0 ** random.uniform(-2, 2, n)
    triangle = np.linalg.qr(np.column_stack([jacobian, random.normal(size=len(jacobian))]), mode="r")
    found = collinearity(triangle, len(jacobian), parameters)
    assert set(found.parameters) == set(parameters.names[:n])
    assert_is_belsleys(jacobian, parameters, found)


def test_correlation_of_a_half_by_hand():
    """Two columns at 60 degrees, orthogonal to W's and T's: indexes 1, sqrt(3), inflation 4/3, proportions 1/4, 3/4."""
    jacobian = np.zeros((20, 2 + N_FRAMES))
    jacobian[:2, :2] = [[1, 0.5], [0, np.sqrt(0.75)]]
    jacobian[2 : 2 + N_FRAMES, 2:] = np.eye(N_FRAMES)
    found = collinearity(np.column_stack([jacobian, np.ones(20)]), 20, made_up(2))
    np.testing.assert_allclose(found.condition_indexes, [1, np.sqrt(3)])
    np.testing.assert_allclose(found.inflation, [4 / 3, 4 / 3])
    np.testing.assert_allclose(found.proportions, [[0.25, 0.25], [0.75, 0.75]])


def test_a_parameter_that_cannot_be_told_from_others_is_left_out():
    """Three columns of which one is the sum of the others, and one of zeros: two are left, or as many as the rank."""
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(40, 4 + N_FRAMES))
    jacobian[:, 2] = jacobian[:, 0] * 1e-1 + jacobian[:, 1]
    jacobian[:, 3] = 0
    parameters = made_up(4)
    found = collinearity(np.column_stack([jacobian, np.ones(40)]), 40, parameters)
    assert len(found.parameters) == 2
    assert "a3" not in found.parameters
    assert_is_belsleys(jacobian, parameters, found)


def test_nothing_seen():
    jacobian = np.zeros((30, 3 + N_FRAMES))
    jacobian[:N_FRAMES, 3:] = np.eye(N_FRAMES)
    found = collinearity(np.column_stack([jacobian, np.ones(30)]), 30, made_up(3))
    assert found.parameters == ()
    assert found.proportions.shape == (0, 0)


@pytest.mark.parametrize(
    "name, channels",
    [
        ("ups3_s", ("orientation",)),
        ("ups2_u", ("tilt",)),
        ("ur10", ("orientation", "position")),
        ("rps3", ("position",)),
    ],
)
def test_robots(name, channels, robot):
    """The streamed triangle of a registered robot against its tall Jacobian; as many parameters as the rank."""
    loaded = robot(name)
    measured = loaded.measure(loaded.random_parameters(1), loaded.readings(70, 1), channels)
    registered, parameters = register(loaded.model, measured), loaded.model.parameters
    jacobian = loaded.model.jacobian(registered.p, measured, registered.q).reshape(-1, len(parameters))
    found = collinearity(registered.triangle, measured.rows, parameters)
    seen = identifiability(jacobian, parameters)
    frames = np.linalg.matrix_rank(jacobian[:, -N_FRAMES:] * 1e-3, rtol=1e-9)
    assert len(found.parameters) == seen.rank - frames
    assert_is_belsleys(jacobian, parameters, found)
