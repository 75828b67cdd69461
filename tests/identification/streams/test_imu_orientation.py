"""An Imu whose orientation is never set is an inclinometer; attitudes by scipy."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.identification.streams.imu import Orientation, imu_chunk, imu_row, orientation_of

ANGLES = np.random.default_rng(8).uniform(-0.4, 0.4, (40, 3))  # roll, pitch, yaw
IDENTITY, ZERO = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(4)
YAWS = Rotation.from_euler("z", ANGLES[:, 2:]).as_quat()


def messages(quaternions, covariance=0.0, angles=ANGLES, gravity=9.81):
    """What a driver sends that writes these quaternions; its accelerometer says the truth."""
    up = Rotation.from_euler("ZYX", angles[:, ::-1]).inv().apply([0, 0, gravity])
    vectors = [SimpleNamespace(x=a[0], y=a[1], z=a[2]) for a in up]
    quaternions = np.broadcast_to(quaternions, (len(angles), 4))
    return [
        SimpleNamespace(
            orientation=SimpleNamespace(x=q[0], y=q[1], z=q[2], w=q[3]),
            orientation_covariance=[covariance] * 9,
            angular_velocity=vector,
            linear_acceleration=vector,
        )
        for q, vector in zip(quaternions, vectors, strict=True)
    ]


def chunk(sent, setting=None):
    orientation = orientation_of(sent, setting)
    rows = np.array([(float(k), *imu_row(message)) for k, message in enumerate(sent)])
    return imu_chunk(rows, orientation), orientation


@pytest.mark.parametrize(
    ("quaternion", "covariance", "setting"),
    [(IDENTITY, 0.0, None), (ZERO, 0.0, None), (IDENTITY, -1.0, None), (IDENTITY, 0.0, False), ([0.5] * 4, 0.01, None)],
)
@pytest.mark.parametrize("gravity", [9.81, 1.0])  # m/s2, or g: its size does not matter
def test_an_orientation_that_is_never_set(quaternion, covariance, setting, gravity):
    """Tilt from the accelerometer, whatever constant the driver writes; no yaw; it is said, unless it was wanted."""
    samples, orientation = chunk(messages(quaternion, covariance, gravity=gravity), setting)
    np.testing.assert_allclose(samples[["roll", "pitch"]], ANGLES[:, :2], atol=1e-12)
    assert samples["yaw"].isna().all()
    assert ("kincal used the accelerometer" in orientation.note) == (setting is None)


def test_an_orientation_that_knows_the_heading_alone():
    samples, orientation = chunk(messages(YAWS))
    np.testing.assert_allclose(samples[["roll", "pitch", "yaw"]], ANGLES, atol=1e-12)
    assert "roll and pitch of the orientation never change" in orientation.note


@pytest.mark.parametrize("setting", [None, True])
def test_an_orientation_that_is_set(setting):
    """Its tilt is used, though the accelerometer says another; and where robot.toml asks for it, even a constant."""
    sent = messages(Rotation.from_euler("ZYX", ANGLES[:, ::-1]).as_quat(), angles=0.5 * ANGLES)
    samples, orientation = chunk(sent, setting)
    np.testing.assert_allclose(samples[["roll", "pitch", "yaw"]], ANGLES, atol=1e-12)
    assert orientation == Orientation(tilt=True, yaw=True)
    constant, _ = chunk(messages(IDENTITY), True)
    np.testing.assert_array_equal(constant[["roll", "pitch", "yaw"]], 0.0)


@pytest.mark.parametrize("few", [ANGLES[:9], np.tile(ANGLES[:1], (40, 1))])
def test_no_variance_tells(few):
    """Few messages, or a sensor that never moved and has no noise: its orientation may be right."""
    assert orientation_of(messages(IDENTITY, angles=few), None) == Orientation(tilt=True, yaw=True)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 10), max_size=14))
def test_any_numbers(rows):
    """Whatever a message holds: an attitude or NaN, no error and no warning."""
    sent = [
        SimpleNamespace(
            orientation=SimpleNamespace(x=r[0], y=r[1], z=r[2], w=r[3]),
            orientation_covariance=[r[4]],
            angular_velocity=SimpleNamespace(x=r[5], y=r[6], z=r[7]),
            linear_acceleration=SimpleNamespace(x=r[7], y=r[8], z=r[9]),
        )
        for r in rows
    ]
    orientation = orientation_of(sent, None)
    if rows:
        imu_chunk(np.array([(0.0, *imu_row(message)) for message in sent], float), orientation)
