"""The attitude filter on motions with a known attitude: signs, accuracy, covariance, gaps and outliers, real time."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.attitude.filter import AttitudeFilter, filter_attitude
from kincal.identification.attitude.presets import PRESETS
from kincal.identification.attitude.settings import AttitudeSettings, Samples, WaveBand
from kincal.identification.attitude.smoother import smooth_attitude
from kincal.urdf.errors import InputError

SENSOR = PRESETS["industrial"]
STILL = AttitudeSettings(waves=None)
RATE = 50.0
GRAVITY = 9.80665  # m/s2


def held(angles_deg, seconds: float = 20.0, noise: float = 0.0, seed: int = 0):
    """Times, specific force and rates of a target at rest at roll, pitch, yaw [deg]."""
    t = np.arange(0.0, seconds, 1 / RATE)
    up = Rotation.from_euler("ZYX", np.array(angles_deg)[::-1], degrees=True).as_matrix()[2]
    random = np.random.default_rng(seed)
    force = GRAVITY * up + noise * SENSOR.acceleration_noise * np.sqrt(RATE) * random.normal(size=(len(t), 3))
    return t, force, noise * SENSOR.gyro_noise * np.sqrt(RATE) * random.normal(size=(len(t), 3))


def at_sea(seconds: float, seed: int, bias: float = 1.0):
    """A ship by a few harmonics: times, true angles (n, 3), force and rates as an industrial sensor has them.

    Rates are derivatives of the rotation by central differences of scipy's rotations: independent of the filter.
    Also the bias of the accelerometer (3,).
    """
    random = np.random.default_rng([seed, 1])
    t = np.arange(0.0, seconds, 1 / RATE)

    def harmonics(size: float) -> tuple[np.ndarray, np.ndarray]:
        w = 2 * np.pi / random.uniform(6.0, 12.0, 12)
        amplitude, phase = size * np.sqrt(2 / 12), random.uniform(0, 2 * np.pi, 12)
        wave = np.exp(1j * (np.multiply.outer(t, w) + phase))
        return amplitude * wave.real.sum(axis=1), -amplitude * (wave * w**2).real.sum(axis=1)

    angles = np.stack([harmonics(np.deg2rad(size))[0] for size in (2.0, 0.8, 0.4)], axis=1)
    acceleration = np.stack([harmonics(size)[1] for size in (0.25, 0.4, 0.5)], axis=1)
    rotation = Rotation.from_euler("ZYX", angles[:, ::-1])
    step = (rotation[:-1].inv() * rotation[1:]).as_rotvec() * RATE  # over an interval; a sample has the mean of two
    rates = np.vstack([step[:1], (step[1:] + step[:-1]) / 2, step[-1:]])
    force = rotation.inv().apply(acceleration + np.array([0, 0, GRAVITY]))
    off = bias * SENSOR.acceleration_bias * random.normal(size=3)
    force += off + SENSOR.acceleration_noise * np.sqrt(RATE) * random.normal(size=force.shape)
    rates = rates + bias * SENSOR.gyro_bias * random.normal(size=3)
    rates += SENSOR.gyro_noise * np.sqrt(RATE) * random.normal(size=rates.shape)
    return t, angles, force, rates, off


def bias_tilt(angles: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(n, 2) what the accelerometer's bias makes of roll and pitch [rad]."""
    level = Rotation.from_euler("YX", angles[:, 1::-1]).apply(off)
    return np.stack([level[:, 1], -level[:, 0]], axis=1) / GRAVITY


@pytest.fixture(scope="module")
def sea():
    return at_sea(150.0, seed=3)


@pytest.mark.parametrize("angles_deg", [(0, 0, 0), (10, 0, 0), (0, 10, 0), (-20, 35, 0), (60, -50, 0), (170, 5, 0)])
@pytest.mark.parametrize("sensor", ["acceleration", "tilt"])
def test_signs_of_a_known_attitude(angles_deg, sensor):
    """Against the attitude itself: roll to starboard down is positive, pitch positive is bow down (z is up)."""
    t, force, gyro = held(angles_deg)
    tilt = np.tile(np.deg2rad(angles_deg[:2]), (len(t), 1))
    samples = Samples(force, gyro) if sensor == "acceleration" else Samples(gyro=gyro, tilt=tilt)
    found = filter_attitude(t, samples, STILL).roll_pitch_yaw
    np.testing.assert_allclose(np.rad2deg(found[-1]), angles_deg, atol=1e-6)


def test_a_turn_by_the_gyro_alone():
    """Against the turn: 1 deg/s about each body axis is positive roll, pitch, yaw; yaw starts at 0 unknown."""
    t, force, gyro = held((0, 0, 0), seconds=12.0)
    for axis in range(3):
        turning = gyro.copy()
        turning[t > 6, axis] = np.deg2rad(1.0)
        samples = Samples(np.where((t > 6)[:, None], np.nan, force), turning)
        found = np.rad2deg(filter_attitude(t, samples, STILL).roll_pitch_yaw[-1])
        np.testing.assert_allclose(found, np.eye(3)[axis] * (t[-1] - 6), atol=0.03)


def test_heading_turns_yaw_and_finds_the_gyros_bias():
    """Against the heading and the bias that were put in; the tilt is as without a heading."""
    t, force, gyro = held((3, -4, 0), seconds=200.0, noise=1.0)
    bias = np.deg2rad([0.02, -0.03, 0.05])
    random = np.random.default_rng(5)
    heading = np.deg2rad(179.5 + 0.5 * random.normal(size=len(t)))
    heading = (heading + np.pi) % (2 * np.pi) - np.pi  # across half a turn
    found = filter_attitude(t, Samples(force, gyro + bias, heading=heading), STILL)
    off = np.rad2deg(found.roll_pitch_yaw[-1]) - [3, -4, 179.5]
    assert abs((off[2] + 180) % 360 - 180) < 3 * np.rad2deg(found.std[-1, 2]) < 0.5
    np.testing.assert_allclose(np.rad2deg(found.gyro_bias[-1] - bias), 0.0, atol=0.01)
    assert [s.channel for s in found.innovations] == ["force", "heading"]


def test_at_sea(sea):
    """Against the truth: 0.05 degrees rms after a minute net of bias, as the filter says of itself; biases found."""
    t, angles, force, gyro, off = sea
    found = filter_attitude(t, Samples(force, gyro), AttitudeSettings())
    errors = found.roll_pitch_yaw[:, :2] - angles[:, :2] - bias_tilt(angles, off)
    late = t > 60
    assert np.rad2deg(np.sqrt(np.mean(errors[late] ** 2))) < 0.05
    assert np.mean(np.abs(errors[late]) < 3 * found.bias_free_std[late]) > 0.9
    plain = np.arctan2(force[:, 1], force[:, 2]) - angles[:, 0]
    assert np.sqrt(np.mean(errors[late] ** 2)) < 0.1 * plain[late].std()
    # with its bias the error is within what the preset says of biases
    assert (found.std[late] > found.bias_free_std[late].max()).any()
    statistics = found.innovations[0]
    assert statistics.updates > 300
    assert 0.85 < statistics.inside <= 1.0


def test_the_smoother_is_better_and_its_covariance_true():
    """Against the truth, over three records from their first second: smaller errors, within their 95 % as promised."""
    errors, normed, filtered = [], [], []
    for seed in (11, 12, 13):
        t, angles, force, gyro, off = at_sea(90.0, seed)
        smooth = smooth_attitude(t, Samples(force, gyro), AttitudeSettings())
        error = smooth.roll_pitch_yaw[:, :2] - angles[:, :2] - bias_tilt(angles, off)
        one = filter_attitude(t, Samples(force, gyro), AttitudeSettings()).roll_pitch_yaw
        errors.append(error)
        filtered.append(one[:, :2] - angles[:, :2] - bias_tilt(angles, off))
        normed.append(error / smooth.bias_free_std)
    assert np.std(errors) < 0.6 * np.std(filtered)
    assert np.mean(np.abs(normed) < 1.96) > 0.8


def test_smoother_of_a_still_target_is_the_mean():
    """Against the mean of the samples: with a quiet gyro nothing moved, so each attitude is that of all samples."""
    t, force, _ = held((2, -3, 0), seconds=30.0, noise=1.0)
    quiet = replace(SENSOR, gyro_noise=1e-9, gyro_bias=1e-9, gyro_instability=1e-12)
    quiet = replace(quiet, acceleration_bias=1e-7, acceleration_instability=1e-9)  # else it has its share in the start
    found = smooth_attitude(t, Samples(force, np.zeros_like(force)), AttitudeSettings(sensor=quiet, waves=None))
    x, y, z = force.mean(axis=0)
    mean = np.array([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))])
    np.testing.assert_allclose(found.roll_pitch_yaw[:, :2], np.tile(mean, (len(t), 1)), atol=2e-6)


def test_real_time_is_the_same(sea):
    """Against `filter_attitude`: one sample a step, to rounding and the second order of a block's bias."""
    t, _, force, gyro, _ = (x[:2990] for x in sea)  # whole blocks of 13
    whole = filter_attitude(t, Samples(force, gyro), AttitudeSettings()).roll_pitch_yaw
    unit = AttitudeFilter(AttitudeSettings(), RATE)
    found = [unit.step(float(time), Samples(f, g)) for time, f, g in zip(t, force, gyro, strict=True)]
    some = np.array([f is not None for f in found])
    assert 5.0 * RATE <= (~some).sum() <= 5.5 * RATE
    np.testing.assert_allclose(np.array([f for f in found if f is not None]), whole[some], atol=1e-7)


def test_long_records_go_chunk_by_chunk(sea, monkeypatch):
    """Against one chunk: where a record is cut makes no difference."""
    t, _, force, gyro, _ = (x[:2000] for x in sea)
    whole = filter_attitude(t, Samples(force, gyro), AttitudeSettings())
    monkeypatch.setattr("kincal.identification.attitude.filter._CHUNK", 30)
    cut = filter_attitude(t, Samples(force, gyro), AttitudeSettings())
    np.testing.assert_allclose(cut.roll_pitch_yaw, whole.roll_pitch_yaw, rtol=0, atol=1e-12)
    np.testing.assert_allclose(cut.std, whole.std, rtol=1e-9)


def test_the_start_is_not_one_sample(sea):
    """Against the clean record: a first second of nonsense does not matter after ten."""
    t, angles, force, gyro, off = (x[:1500] if len(x) > 3 else x for x in sea)
    spoiled = force.copy()
    spoiled[:50] = [GRAVITY, 0.0, 0.0]
    found = filter_attitude(t, Samples(spoiled, gyro), AttitudeSettings())
    errors = found.roll_pitch_yaw[:, :2] - angles[:, :2] - bias_tilt(angles, off)
    assert np.rad2deg(np.abs(errors[t > 10])).max() < 0.5


def test_outliers_and_dropouts_cost_little(sea):
    """Against the same record without them: spikes of both sensors, missing samples, and a gap of two seconds."""
    t, angles, force, gyro, off = sea
    random = np.random.default_rng(8)
    force, gyro = force.copy(), gyro.copy()
    force[random.random(len(t)) < 0.01] += 5.0
    gyro[random.random(len(t)) < 0.005] += 1.0
    force[random.random(len(t)) < 0.02] = np.nan
    gyro[random.random(len(t)) < 0.02] = np.nan
    kept = (t < 50) | (t > 52)
    found = filter_attitude(t[kept], Samples(force[kept], gyro[kept]), AttitudeSettings())
    errors = found.roll_pitch_yaw[:, :2] - (angles[:, :2] + bias_tilt(angles, off))[kept]
    assert np.rad2deg(np.sqrt(np.mean(errors[t[kept] > 100] ** 2))) < 0.08


def test_a_stretch_of_wrong_updates_is_gated_and_recovered_from(sea):
    """A sensor that is knocked for two seconds: refused; one that stays off is believed in the end."""
    t, _, force, gyro, _ = sea
    knocked = force + np.where((t > 80) & (t < 82), 3.0, 0.0)[:, None] * [0, 1, 0]
    clean = filter_attitude(t, Samples(force, gyro), AttitudeSettings())
    found = filter_attitude(t, Samples(knocked, gyro), AttitudeSettings())
    assert found.innovations[0].gated >= 3
    difference = np.rad2deg(np.abs(found.roll_pitch_yaw - clean.roll_pitch_yaw)[:, :2])
    assert difference[t > 140].max() < 0.1


def test_without_a_gyro():
    """An inclinometer at sea: the filter beats its tilt, and its sigma holds the error; still, it is the mean."""
    t, angles, force, _, off = at_sea(150.0, seed=4)
    tilt = np.stack([np.arctan2(force[:, 1], force[:, 2]), np.arctan2(-force[:, 0], np.hypot(*force[:, 1:].T))], axis=1)
    settings = AttitudeSettings(waves=WaveBand(acceleration=0.3, roll_pitch_deg=1.5))
    found = filter_attitude(t, Samples(tilt=tilt), settings)
    errors = found.roll_pitch_yaw[:, :2] - angles[:, :2] - bias_tilt(angles, off)
    assert np.std(errors[t > 30]) < 0.9 * np.std((tilt - angles[:, :2])[t > 30])
    assert np.mean(np.abs(errors[t > 30]) < 1.96 * found.bias_free_std[t > 30]) > 0.9
    t, force, _ = held((4, -2, 0), seconds=30.0, noise=1.0)
    found = filter_attitude(t, Samples(force), STILL)
    np.testing.assert_allclose(np.rad2deg(found.roll_pitch_yaw[-1, :2]), [4, -2], atol=0.01)


@pytest.mark.parametrize(
    "samples, said",
    [
        (Samples(gyro=np.zeros((500, 3))), "neither"),
        (Samples(np.zeros((500, 3)), tilt=np.zeros((500, 2))), "both"),
        (Samples(np.zeros((500, 2))), "(500, 3)"),
        (Samples(np.zeros((500, 3)), np.zeros((499, 3))), "gyro"),
        (Samples(np.full((500, 3), np.nan)), "no good sample"),
    ],
)
def test_bad_input_is_refused(samples, said):
    with pytest.raises(InputError, match=r"deck\.csv") as error:
        filter_attitude(np.arange(500) / RATE, samples, STILL, "deck.csv")
    assert said in str(error.value)


def test_times_that_run_backwards_and_short_records_are_refused():
    t, force, gyro = held((0, 0, 0), seconds=10.0)
    with pytest.raises(InputError, match="none before"):
        filter_attitude(t[::-1], Samples(force, gyro), STILL)
    with pytest.raises(InputError, match="at least 5 s"):
        filter_attitude(t[:100], Samples(force[:100], gyro[:100]), STILL)


def test_a_start_without_samples_is_refused_in_real_time():
    unit = AttitudeFilter(STILL, RATE)
    nothing = Samples(np.full(3, np.nan), np.zeros(3))
    for k in range(unit.starting - 1):
        assert unit.step(k / RATE, nothing) is None
    with pytest.raises(InputError, match="start has no good sample"):
        unit.step(unit.starting / RATE, nothing)


def test_ten_thousand_samples_a_second(sea):
    """Against the clock (CPU time)."""
    t, _, force, gyro, _ = sea
    filter_attitude(t[:1000], Samples(force[:1000], gyro[:1000]), AttitudeSettings())
    began = time.process_time()
    filter_attitude(t, Samples(force, gyro), AttitudeSettings())
    assert len(t) / (time.process_time() - began) > 10_000
