"""How sure a prediction is: regions against drawn errors, and against virtual robots that no tuning has seen."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.identification.channels import TILT
from kincal.pipeline.methods.covariance import pose_covariance, radius, sigma
from kincal.urdf.rigid_motion import log


def covariances(k: int, seed: int, n: int = 3) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, k, k)) * np.array([1.0, 0.3, 2.0])[:k]
    return root @ root.swapaxes(1, 2)


@given(seed=st.integers(0, 40), k=st.integers(1, 3))
def test_radius_holds_what_it_says(seed, k):
    """Of errors drawn from the covariance: 95 %, to the one or two per cent of the approximation."""
    c = covariances(k, seed, n=1)
    error = np.random.default_rng(seed).multivariate_normal(np.zeros(k), c[0], 20_000)
    assert np.mean(np.linalg.norm(error, axis=1) < radius(c)[0]) == pytest.approx(0.95, abs=0.02)


def test_radius_of_one_and_of_equal_axes():
    """1.96 sigma along one axis; the chi-square's own quantile, 2.795 sigma, in three."""
    np.testing.assert_allclose(radius(4.0 * np.eye(1)[None]), 2 * 1.959964, rtol=1e-6)
    np.testing.assert_allclose(radius(4.0 * np.eye(3)[None]), 2 * 2.795483, rtol=1e-6)
    assert radius(np.zeros((1, 3, 3)))[0] < 1e-100


def test_sigma_is_the_root_mean_square_of_the_axes():
    c = covariances(3, 1)
    expected = [np.sqrt(np.mean(np.diag(one))) for one in c]
    np.testing.assert_allclose(sigma(c), expected, rtol=1e-12)
    np.testing.assert_allclose(sigma(c, axes=2), np.sqrt(1.5) * np.array(expected), rtol=1e-12)


def test_tilt_takes_the_turn_about_the_vertical_off():
    """Against drawn rotation vectors whose part along it is left out."""
    c = covariances(3, 2)
    up = np.random.default_rng(3).normal(size=(3, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    whole = np.zeros((3, 6, 6))
    whole[:, :3, :3] = c
    upright = np.array([Rotation.align_vectors([[0, 0, 1]], [axis])[0].as_matrix() for axis in up])
    for found, one, axis in zip(TILT.covariance(whole, upright), c, up, strict=True):
        drawn = np.random.default_rng(4).multivariate_normal(np.zeros(3), one, 200_000)
        flat = drawn - np.outer(drawn @ axis, axis)
        np.testing.assert_allclose(found, np.cov(flat.T), rtol=0, atol=0.02 * np.abs(one).max())
        np.testing.assert_allclose(found @ axis, 0, atol=1e-12)


def test_between_the_two_it_goes_as_the_prediction(calibrated):
    """Share 0: geometric's covariance to the last bit; 1: the refined one's; else the mean with weights."""
    case = calibrated("ups3_s", 60, 0, inner=0.5)
    readings = case.readings(60, seed=95)
    assert case.corrected.correction.shrinkage > 0.5

    def found(method, corrected=case.corrected) -> np.ndarray:
        return pose_covariance(case.model, case.fit, corrected, method, readings)

    geometric, hybrid, share = found(case.geometric), found(case.hybrid), case.hybrid.correction.share(readings)
    np.testing.assert_array_equal(hybrid[share == 0], geometric[share == 0])
    everywhere = replace(case.hybrid.correction, shrinkage=1.0, hull=replace(case.hybrid.correction.hull, reach=np.inf))
    whole = found(replace(case.hybrid, correction=everywhere), replace(case.corrected, correction=everywhere))
    inside = share > 0
    part = share[inside, None, None]
    expected = part * whole[inside] + (1 - part) * geometric[inside]
    np.testing.assert_allclose(hybrid[inside], expected, rtol=0, atol=1e-12 * expected.max())
    np.testing.assert_allclose(hybrid, hybrid.swapaxes(1, 2), rtol=0, atol=1e-15 * hybrid.max())
    assert np.linalg.eigvalsh(hybrid).min() > -1e-9 * hybrid.max()
    assert 5 < (share == 0).sum() < 55


def test_regions_hold(calibrated):
    """Of robots that no tuning has seen, pooled: 95 % of true orientations lie within, to a few per cent."""
    held = {"geometric": [], "hybrid": []}
    for seed in range(300, 305):
        case = calibrated("ups3_s", 60, seed)
        readings = case.readings(150, seed=96)
        truth = case.virtual.pose(readings)
        for name, method in (("geometric", case.geometric), ("hybrid", case.hybrid)):
            covariance = pose_covariance(case.model, case.fit, case.corrected, method, readings)[:, :3, :3]
            error = np.linalg.norm(log(method.predict(readings).rotation.swapaxes(1, 2) @ truth.rotation), axis=1)
            held[name].append(np.mean(error < radius(covariance)))
    for name, shares in held.items():
        assert 0.90 <= np.mean(shares) <= 0.99, (name, shares)
