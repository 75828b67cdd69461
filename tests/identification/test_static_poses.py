"""The batch of static poses against filterpy's filter, pose by pose, and against the white-noise bound."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.static_poses import static_attitude, static_attitudes
from kincal.urdf.description import Filter


def _recorded(seed: int, counts: np.ndarray, k: int, sigma: float, outliers: float):
    """Times (n,) [s], samples (n, k), true angles (m, k) [rad] of poses of unequal lengths, with gaps and repeats."""
    random = np.random.default_rng(seed)
    true = random.uniform(-np.pi, np.pi, (len(counts), k))
    n = counts.sum()
    steps = 0.02 * random.choice([0.0, 1.0, 1.0, 1.0, 40.0], n)
    samples = np.repeat(true, counts, axis=0) + sigma * random.normal(size=(n, k))
    wrong = random.random((n, k)) < outliers
    samples += np.where(wrong, random.uniform(-1, 1, (n, k)) * random.choice([0.01, 0.1, 3.0], n)[:, None], 0.0)
    return np.cumsum(steps), (samples + np.pi) % (2 * np.pi) - np.pi, true


@given(
    seed=st.integers(0, 10**6),
    counts=st.lists(st.integers(1, 40), min_size=1, max_size=8),
    k=st.sampled_from([2, 3]),
    sigma=st.sampled_from([1e-5, 2e-4, 1e-2]),
    outliers=st.sampled_from([0.0, 0.01, 0.4]),
    settings=st.builds(
        Filter,
        gate_probability=st.sampled_from([1e-4, 1e-2]),
        window=st.sampled_from([3, 4, 25]),
        drift_deg_per_sqrt_s=st.sampled_from([0.0, 1e-5, 0.1]),
    ),
)
def test_the_batch_is_filterpy_pose_by_pose(seed, counts, k, sigma, outliers, settings):
    """Against `static_attitude`, which steps filterpy: angles, covariance and counts, whatever the lengths and gaps."""
    counts = np.array(counts)
    t, samples, _ = _recorded(seed, counts, k, sigma, outliers)
    noise = sigma * np.array([1.0, 1.5, 3.0])[:k]
    batch = static_attitudes(t, samples, counts, noise, settings)
    for m, (end, count) in enumerate(zip(np.cumsum(counts), counts, strict=True)):
        alone = static_attitude(t[end - count : end], samples[end - count : end], noise, settings)
        np.testing.assert_allclose(batch.angles[m], alone.angles, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.diag(batch.variances[m]), alone.covariance, rtol=1e-12, atol=1e-18)
        assert (batch.used[m], batch.gated[m]) == (alone.used, alone.gated)


@pytest.mark.parametrize("seed", range(3))
def test_as_good_as_white_noise_allows(seed):
    """5 s at 50 Hz, a sample in a hundred an outlier: rms within 1.3 times sigma / sqrt(n), 95 % intervals are true."""
    sigma, counts = np.deg2rad(0.01), np.full(2000, 250)
    random = np.random.default_rng([seed, 5])
    true = random.uniform(-0.4, 0.4, (len(counts), 2))
    samples = np.repeat(true, counts, axis=0) + sigma * random.normal(size=(counts.sum(), 2))
    wrong = random.random(len(samples)) < 0.01
    samples[wrong] += np.deg2rad(2.0) * random.choice([-1.0, 1.0], (wrong.sum(), 2))
    found = static_attitudes(np.arange(len(samples)) / 50, samples, counts, np.full(2, sigma), Filter())
    errors = found.angles - true
    assert np.sqrt(np.mean(errors**2)) < 1.3 * sigma / np.sqrt(250)
    assert 0.93 <= np.mean(np.abs(errors) < 1.959964 * np.sqrt(found.variances)) <= 0.97


def test_a_hundred_thousand_samples_a_second():
    """Against the clock; CPU time, so that neighbours on the machine don't count."""
    counts = np.full(216, 250)
    t, samples, _ = _recorded(0, counts, 3, 2e-4, 0.01)
    began = time.process_time()
    static_attitudes(t, samples, counts, np.full(3, 2e-4), Filter())
    assert counts.sum() / (time.process_time() - began) > 100_000


@pytest.mark.parametrize("stated, expected", [(1.0, 1.0), (2.0, 0.25), (0.95, 1 / 0.9025)])
def test_innovations_have_the_size_of_what_was_stated(stated, expected):
    """Mean squares of white noise in units of the sigma that the filter was told; 4 standard errors."""
    sigma, counts = 2e-4, np.full(60, 250)
    t, samples, _ = _recorded(7, counts, 3, sigma, 0.0)
    found = static_attitudes(t, samples, counts, np.full(3, stated * sigma), Filter(drift_deg_per_sqrt_s=0.0))
    assert (found.judged > 0.95 * counts.sum()).all()
    assert found.innovations == pytest.approx(np.full(3, expected), rel=4 * np.sqrt(2 / counts.sum()))
