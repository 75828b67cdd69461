"""The paper's indices (eq. 7-10) against scipy's rotation magnitudes and plain statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.identification.accuracy import gravity_error, orientation_error, score
from kincal.urdf.rigid_motion import Motion, vee


def pairs(seed: int, size: float, n: int = 30) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Actual orientations anywhere, predicted ones off by rotation vectors of about `size` [rad], and those vectors."""
    random = np.random.default_rng(seed)
    actual = Rotation.random(n, rng=random)
    vector = size * random.normal(size=(n, 3))
    return actual.as_matrix(), (actual * Rotation.from_rotvec(vector)).as_matrix(), vector


@given(seed=st.integers(0, 10**6), size=st.sampled_from([1e-9, 1e-6, 1e-4, 1e-2]))
def test_orientation_error_is_the_rotation_vector_for_small_errors(seed, size):
    """The vector of the skew part (eq. 7 and 8) to third order, |v|^3 / 6 (as sin v = v - v^3 / 6); scipy's angle."""
    actual, predicted, vector = pairs(seed, size)
    length = np.linalg.norm(vector, axis=1)
    error = orientation_error(actual, predicted)
    assert np.all(np.linalg.norm(error - vector, axis=1) <= length**3 / 6 + 1e-15)
    magnitude = Rotation.from_matrix(np.swapaxes(actual, 1, 2) @ predicted).magnitude()
    np.testing.assert_allclose(np.linalg.norm(error, axis=1), magnitude, rtol=1e-6, atol=1e-15)
    skew = vee(np.swapaxes(actual, 1, 2) @ predicted)
    assert np.all(np.linalg.norm(error - skew, axis=1) <= length**3 / 6 + 1e-15)


@given(seed=st.integers(0, 10**6), size=st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 0.3]))
def test_gravity_error_is_the_rotation_between_the_verticals(seed, size):
    """Its length is the angle between the two verticals, and it turns the one into the other."""
    actual, predicted, _ = pairs(seed, size)
    error = gravity_error(actual, predicted)
    up = np.array([0.0, 0.0, 1.0])
    first, second = np.swapaxes(actual, 1, 2) @ up, np.swapaxes(predicted, 1, 2) @ up
    angle = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), np.sum(first * second, axis=1))
    np.testing.assert_allclose(np.linalg.norm(error, axis=1), angle, rtol=1e-9, atol=1e-15)
    # R_actual^T up = exp(error) R_predicted^T up: seen from the tool, as orientation_error is
    np.testing.assert_allclose(Rotation.from_rotvec(error).apply(second), first, rtol=0, atol=1e-12)


def test_gravity_error_is_orientation_error_without_the_turn_about_the_vertical():
    """Level tool, small error: the same x and y, no z."""
    vector = np.array([[1e-5, -2e-5, 3e-5]])
    actual, predicted = np.eye(3)[None], Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(gravity_error(actual, predicted), [[1e-5, -2e-5, 0]], rtol=0, atol=1e-9)
    np.testing.assert_allclose(orientation_error(actual, predicted), vector, rtol=0, atol=1e-14)


def test_yaw_does_not_count_where_tilt_alone_was_measured():
    actual, predicted, _ = pairs(1, 0.1)
    turn = Rotation.from_euler("z", 1.0).as_matrix()
    np.testing.assert_allclose(gravity_error(actual, turn @ predicted), gravity_error(actual, predicted), atol=1e-12)


def test_scores_are_mean_maximum_and_deviation_in_degrees_and_millimetres():
    """Eq. 9 (volumetric) and 10 (per axis), from scipy's magnitudes."""
    actual, predicted, vector = pairs(2, 1e-4)
    moved = 1e-4 * np.random.default_rng(3).normal(size=(30, 3))
    at = np.random.default_rng(4).normal(size=(30, 3))
    found = score(Motion(actual, at), Motion(predicted, at + moved), ("orientation", "position"))
    degrees = np.rad2deg(Rotation.from_matrix(np.swapaxes(actual, 1, 2) @ predicted).magnitude())
    millimetres = 1e3 * np.linalg.norm(moved, axis=1)
    assert found.mean_deg == pytest.approx(degrees.mean(), rel=1e-6)
    assert found.max_deg == pytest.approx(degrees.max(), rel=1e-6)
    assert found.sd_deg == pytest.approx(degrees.std(), rel=1e-6)
    assert found.mean_mm == pytest.approx(millimetres.mean(), rel=1e-9)
    assert found.max_mm == pytest.approx(millimetres.max(), rel=1e-9)
    assert found.sd_mm == pytest.approx(millimetres.std(), rel=1e-9)
    axes = np.rad2deg(np.abs(vector).mean(axis=0))
    for k, axis in enumerate("xyz"):
        assert found.axis_mean_deg[axis] == pytest.approx(axes[k], rel=1e-6)


@pytest.mark.parametrize(
    "channels, turned, about_z, moved",
    [
        (("orientation",), True, True, False),
        (("orientation", "position"), True, True, True),
        (("position",), False, False, True),
        (("tilt",), True, False, False),
        (("tilt", "yaw"), True, True, False),
        (("tilt", "position"), True, False, True),
        (("yaw",), False, False, False),
    ],
)
def test_what_was_not_measured_is_null(channels, turned, about_z, moved):
    """design.md: what was not measured is never invented."""
    actual, predicted, _ = pairs(5, 1e-3)
    found = score(Motion(actual, np.zeros((30, 3))), Motion(predicted, np.ones((30, 3))), channels)
    for value in (found.mean_deg, found.max_deg, found.sd_deg, found.axis_mean_deg["x"], found.axis_mean_deg["y"]):
        assert (value is not None) == turned
    assert (found.axis_mean_deg["z"] is not None) == about_z
    for value in (found.mean_mm, found.max_mm, found.sd_mm):
        assert (value is not None) == moved


def test_tilt_is_scored_by_the_angle_between_the_verticals():
    actual, predicted, _ = pairs(6, 1e-2)
    found = score(Motion(actual, np.zeros((30, 3))), Motion(predicted, np.zeros((30, 3))), ("tilt",))
    angle = np.rad2deg(np.arccos(np.sum(actual[:, 2] * predicted[:, 2], axis=1)))
    assert found.mean_deg == pytest.approx(angle.mean(), rel=1e-8)
    assert found.max_deg == pytest.approx(angle.max(), rel=1e-8)
