"""Wave-band models and innovation statistics against closed forms and simulation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from kincal.identification.attitude.innovations import statistics
from kincal.identification.attitude.presets import PRESETS, preset
from kincal.identification.attitude.wave_band import ACCELERATION, acceleration_by_velocity, angle, displacement
from kincal.urdf.errors import InputError

PERIOD, DAMPING, DT = st.floats(3.0, 30.0), st.floats(0.05, 0.9), st.floats(0.005, 1.0)


@given(PERIOD, DAMPING, DT)
def test_stationary_is_stationary(period, damping, dt):
    """P = F P F' + Q, and the sigma of the acceleration (of the angle) is the one that was asked for."""
    for model, at in ((displacement(period, 0.3, damping, dt), ACCELERATION), (angle(period, 0.3, damping, dt), 0)):
        f, q, p = model.transition, model.noise, model.stationary
        unit = np.sqrt(np.diag(p))
        np.testing.assert_allclose((f @ p @ f.T + q) / np.outer(unit, unit), p / np.outer(unit, unit), atol=1e-9)
        assert unit[at] == pytest.approx(0.3, rel=1e-9)
        assert np.linalg.eigvalsh(q / np.outer(unit, unit)).min() > -1e-12


@given(PERIOD, DAMPING, st.floats(0.01, 0.2), st.integers(2, 5))
def test_steps_compose(period, damping, dt, n):
    """n steps of dt against one of n dt."""
    for kind in (displacement, angle):
        one, all_at_once = kind(period, 0.3, damping, dt), kind(period, 0.3, damping, n * dt)
        f, q = np.eye(len(one.noise)), np.zeros_like(one.noise)
        for _ in range(n):
            f, q = one.transition @ f, one.transition @ q @ one.transition.T + one.noise
        unit = np.sqrt(np.diag(one.stationary))
        np.testing.assert_allclose(
            f * np.outer(1 / unit, unit), all_at_once.transition * np.outer(1 / unit, unit), atol=1e-9
        )
        np.testing.assert_allclose(q / np.outer(unit, unit), all_at_once.noise / np.outer(unit, unit), atol=1e-9)


def test_moments_against_the_spectrum():
    """Against the integrals of w^4 |H|^2 and w^2 |H|^2, H = 1 / (w0^2 - w^2 + 2 i z w0 w)^3."""
    w, w0, z = np.linspace(1e-4, 60.0, 2_000_000), 2 * np.pi / 9.0, 0.15
    power = np.abs(w0**2 - w**2 + 2j * z * w0 * w) ** -6
    ratio = np.sqrt(np.trapezoid(w**4 * power, w) / np.trapezoid(w**2 * power, w)) / w0
    assert acceleration_by_velocity(z) == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("scale, warned", [(1.0, False), (1.5, True), (0.7, True)])
def test_white_innovations(scale, warned):
    """Gaussian numbers: a mean square of scale^2, in its band where it is 1, white, and 95 % inside their own."""
    values = scale * np.random.default_rng(2).normal(size=(4000, 2))
    found = statistics("force", values, np.zeros(4000, dtype=bool))
    assert found.mean == pytest.approx(scale**2, rel=0.05)
    assert (found.warning is not None) == warned
    assert found.whiteness >= 0.8
    assert abs(found.lag_one) < 0.05
    if not warned:
        assert found.inside == pytest.approx(0.95, abs=0.01)


def test_the_band_of_correlated_innovations_holds_their_mean():
    """Against simulation: 90 to 99 % of records of a first-order process have their mean within the band."""
    held, keep = [], 0.7
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(size=(1200, 2)) * np.sqrt(1 - keep**2)
        values = lfilter([1.0], [1.0, -keep], noise, axis=0)[200:]
        found = statistics("force", values, np.zeros(1000, dtype=bool))
        held.append(found.band[0] <= found.mean <= found.band[1])
        assert found.effective < 600
    assert 0.88 <= np.mean(held) <= 0.99


def test_too_few_innovations_are_said_to_be():
    found = statistics("heading", np.ones((20, 1)), np.zeros(20, dtype=bool))
    assert found.warning is not None
    assert "too few" in found.warning


def test_presets():
    """By name; a wrong one names the nearest; better classes are better in all they say."""
    assert preset("industrial") is PRESETS["industrial"]
    with pytest.raises(InputError, match="industrial"):
        preset("industral")
    for better, worse in (("precision", "industrial"), ("mru", "industrial")):
        for name in ("gyro_noise", "gyro_bias", "acceleration_noise", "acceleration_bias", "tilt_noise", "tilt_bias"):
            assert getattr(PRESETS[better], name) < getattr(PRESETS[worse], name)
