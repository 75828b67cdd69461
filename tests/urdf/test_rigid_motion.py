"""Rigid motions: the axioms of a group, and every derivative against central differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from kincal.urdf.rigid_motion import (
    Motion,
    cross,
    exp,
    from_xyz_angles,
    log,
    right_jacobian,
    skew,
    vee,
    wrap,
    xyz_angles,
    xyz_rates,
)

SIZES = (0.0, 1e-300, 1e-12, 1e-9, 1e-6, 0.9e-5, 1.1e-5, 1e-3, 0.1, 1.0)  # near-identity samples among them


def vectors(length: int, largest: float = 1.0):
    """(length,) arrays of entries up to `largest`, of all sizes down to zero."""
    entries = arrays(float, length, elements=st.floats(-1, 1))
    return st.builds(lambda v, size: largest * size * v, entries, st.sampled_from(SIZES))


motions = vectors(6, 1.7).map(Motion.from_vector)


def assert_same(a: Motion, b: Motion) -> None:
    np.testing.assert_allclose(a.rotation, b.rotation, rtol=0, atol=1e-14)
    np.testing.assert_allclose(a.translation, b.translation, rtol=0, atol=1e-13)


@given(a=motions, b=motions)
def test_closure(a, b):
    """A product is a rigid motion: it acts as the one after the other, on points."""
    product = a @ b
    np.testing.assert_allclose(product.rotation @ product.rotation.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(product.rotation) == pytest.approx(1, abs=1e-14)
    point = np.array([0.3, -0.5, 0.7])
    inner = b.rotation @ point + b.translation
    expected = a.rotation @ inner + a.translation
    np.testing.assert_allclose(product.rotation @ point + product.translation, expected, rtol=0, atol=1e-13)


@given(a=motions)
def test_identity_and_inverse(a):
    assert_same(Motion.identity() @ a, a)
    assert_same(a @ Motion.identity(), a)
    assert_same(a @ a.inverse(), Motion.identity())
    assert_same(a.inverse() @ a, Motion.identity())


@given(a=motions, b=motions, c=motions)
def test_associativity(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c))


@given(v=vectors(6, 1.7))
def test_vector_round_trip(v):
    np.testing.assert_allclose(Motion.from_vector(v).vector(), v, rtol=0, atol=1e-14)


def test_batches_broadcast_and_select():
    v = np.random.default_rng(0).normal(size=(4, 6))
    batch, one = Motion.from_vector(v), Motion.from_vector(v[2])
    assert_same((one @ batch)[1], one @ Motion.from_vector(v[1]))
    assert_same((batch @ one)[3], Motion.from_vector(v[3]) @ one)
    assert_same((batch @ batch.inverse())[0], Motion.identity())


@given(v=vectors(3, 1.8))
def test_exp_is_the_matrix_exponential_and_log_its_inverse(v):
    """Against scipy.linalg.expm of the cross-product matrix."""
    np.testing.assert_allclose(exp(v), expm(skew(v)), rtol=0, atol=1e-14)
    np.testing.assert_allclose(log(exp(v)), v, rtol=0, atol=1e-14)


@given(a=vectors(3, 5.0), b=vectors(3, 5.0))
def test_skew_vee_and_cross_are_the_cross_product(a, b):
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=0, atol=1e-13)
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(vee(skew(a)), a)


@given(v=vectors(3, 1.8))
def test_right_jacobian(v, central_difference):
    """exp(v + dv) = exp(v) exp(J dv): central differences of log(exp(v)^T exp(v + dv))."""
    numerical = central_difference(lambda at: Rotation.from_matrix(exp(v).T @ exp(at)).as_rotvec(), v)
    np.testing.assert_allclose(right_jacobian(v), numerical, rtol=0, atol=1e-10)


@given(angles=vectors(3, 1.4))
def test_intrinsic_xyz_angles(angles):
    """R = Rx(a) Ry(b) Rz(c), the three factors written out."""
    a, b, c = angles
    rx, ry, rz = exp(np.array([a, 0, 0])), exp(np.array([0, b, 0])), exp(np.array([0, 0, c]))
    np.testing.assert_allclose(from_xyz_angles(angles), rx @ ry @ rz, rtol=0, atol=1e-14)
    np.testing.assert_allclose(xyz_angles(from_xyz_angles(angles)), angles, rtol=0, atol=1e-14)


@given(angles=vectors(3, 1.2))
def test_xyz_rates(angles, central_difference):
    """d(angles) = B omega, omega turning the frame before the three rotations: R -> exp(omega) R."""
    rotation = from_xyz_angles(angles)
    numerical = central_difference(lambda omega: xyz_angles(exp(omega) @ rotation), np.zeros(3))
    np.testing.assert_allclose(xyz_rates(angles), numerical, rtol=0, atol=1e-8)


@given(angle=st.floats(-50, 50))
def test_wrap_keeps_the_direction(angle):
    wrapped = wrap(np.array(angle))
    assert -np.pi <= wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], rtol=0, atol=1e-14)
