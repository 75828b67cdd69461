"""The filter on smsfusion's own simulated motion and sensor noise, which know nothing of ours."""

import numpy as np
import pytest

from kincal.identification.attitude.filter import filter_attitude
from kincal.identification.attitude.presets import SensorPreset
from kincal.identification.attitude.settings import AttitudeSettings, Samples

FLIP = np.array([1.0, -1.0, -1.0])  # forward, starboard, down <-> forward, port, up


def test_a_beating_motion_as_another_library_simulates_it():
    """Roll and pitch of smsfusion's beating motion (rotation and translation), with its noise and its sensor's figures.

    Pitch and yaw change sign with the axes.
    """
    smsfusion = pytest.importorskip("smsfusion")
    from smsfusion.benchmark import benchmark_full_pva_beat_202311A
    from smsfusion.constants import ERR_ACC_MOTION2 as ACC
    from smsfusion.constants import ERR_GYRO_MOTION2 as GYRO

    rate_hz = 10.24
    t, _, _, euler, force, gyro = benchmark_full_pva_beat_202311A(rate_hz)
    keep = slice(0, round(600 * rate_hz))
    noise = smsfusion.noise.IMUNoise({**ACC, "bc": (0.0,) * 3}, {**GYRO, "bc": (1e-3, -5e-4, 1e-3)}, seed=3)
    errors = noise(rate_hz, keep.stop)
    sensor = SensorPreset(
        "motion",
        rate_hz,
        gyro_noise=GYRO["N"],
        gyro_bias=1e-3,
        gyro_instability=GYRO["B"],
        acceleration_noise=ACC["N"],
        acceleration_bias=1e-3,
        acceleration_instability=ACC["B"],
        tilt_noise=1e-3,
        tilt_bias=1e-3,
        heading_noise=1e-2,
        instability_s=GYRO["tau_cb"],
    )
    samples = Samples((force[keep] + errors[:, :3]) * FLIP, (gyro[keep] + errors[:, 3:]) * FLIP)
    found = filter_attitude(t[keep], samples, AttitudeSettings(sensor))
    off = np.rad2deg(found.roll_pitch_yaw - euler[keep] * FLIP)[t[keep] > 120, :2]
    assert np.sqrt(np.mean(off**2)) < 0.1
    np.testing.assert_allclose(found.gyro_bias[-1, :2], [1e-3, 5e-4], atol=2e-4)
