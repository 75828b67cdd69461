"""Levelling, looking ahead, delay and lag; and what simulated sensors say."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.attitude.presets import PRESETS
from kincal.pipeline.sea.control import ahead, followed, kept, lag, late, levelling
from kincal.pipeline.sea.instruments import sensed

RATE = 100.0


def test_what_levels_the_deck_leaves_the_ships_heading_and_the_decks_own_yaw():
    """Against scipy's Euler angles: ship, then the platform's orientation on board."""
    angles = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 3))  # roll, pitch, yaw
    ship = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    deck = Rotation.from_matrix(ship @ levelling(angles, 0.3)).as_euler("ZYX")
    np.testing.assert_allclose(deck[:, 1:], 0.0, atol=1e-14)
    np.testing.assert_allclose(deck[:, 0], angles[:, 2] + 0.3, atol=1e-14)


def test_a_constant_rate_is_foreseen_exactly():
    """A body that turns steadily about an axis of its own: scipy's rotation vectors."""
    rate = np.array([0.05, -0.08, 0.03])
    start = Rotation.from_euler("ZYX", [0.4, -0.1, 0.2])
    now = np.array([start.as_euler("ZYX")[::-1]])
    later = (start * Rotation.from_rotvec(0.7 * rate)).as_euler("ZYX")[::-1]
    np.testing.assert_allclose(ahead(now, rate[None], 0.7)[0], later, atol=1e-14)


def test_delay_repeats_the_first_value():
    values = np.arange(5.0)[:, None]
    assert late(values, 2)[:, 0].tolist() == [0, 0, 0, 1, 2]
    assert late(values, 0)[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert late(values, 9)[:, 0].tolist() == [0] * 5


@pytest.mark.parametrize("bandwidth_hz", [1.0, 10.0, 40.0])
def test_actuators_lag_behind_a_ramp_by_what_is_said_and_pass_half_the_power_at_their_bandwidth(bandwidth_hz):
    keep = kept(bandwidth_hz, RATE)
    t = np.arange(2000) / RATE
    behind = t - followed(t[:, None], keep)[:, 0]
    assert behind[-1] == pytest.approx(lag(keep, RATE), rel=1e-9)
    fine = 1e5  # where sampling plays no part
    t = np.arange(int(20 * fine / bandwidth_hz)) / fine
    wave = followed(np.sin(2 * np.pi * bandwidth_hz * t)[:, None], kept(bandwidth_hz, fine))[:, 0]
    assert np.std(wave[len(t) // 2 :]) / np.std(np.sin(2 * np.pi * bandwidth_hz * t)) == pytest.approx(
        2**-0.5, rel=2e-3
    )


def test_actuators_that_rest_stay():
    np.testing.assert_array_equal(followed(np.full((20, 3), 0.4), kept(5.0, RATE)), 0.4)


def test_sensors_err_as_their_preset_says():
    """White noise by differences of neighbours, the bias by many switch-ons, its wander by means over 100 s."""
    sensor = PRESETS["industrial"]
    still = np.zeros((20_000, 3))
    read = sensed(still, still, RATE, sensor, [3]).samples
    for values, density in ((read.acceleration, sensor.acceleration_noise), (read.gyro, sensor.gyro_noise)):
        white = np.std(np.diff(values, axis=0)) / np.sqrt(2)
        assert white == pytest.approx(density * np.sqrt(RATE), rel=0.02)
    starts = [sensed(still[:100], still[:100], RATE, sensor, [k]).samples.gyro for k in range(400)]
    biases = np.mean(starts, axis=1)
    within = np.hypot(sensor.gyro_bias, sensor.gyro_noise)  # of a second's mean
    assert np.std(biases) == pytest.approx(np.hypot(within, sensor.gyro_instability), rel=0.06)


def test_the_same_seed_gives_the_same_samples_and_another_one_others():
    still = np.zeros((10, 3))
    first, again, other = (sensed(still, still, RATE, PRESETS["mru"], [k]).samples.gyro for k in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0
