"""Each channel of the registry against formulas of its own and finite differences. A new channel is tested, too."""

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.channels import (
    BY_ROWS,
    CHANNELS,
    ORIENTATION,
    POSITION,
    TILT,
    YAW,
    all_turns,
    merged,
    named,
    parts,
    scored,
)
from kincal.identification.channels.channel import Channel
from kincal.identification.error_model import pose_residual
from kincal.identification.measurements import Measurements
from kincal.urdf.description import SENSORS, Sensor
from kincal.urdf.rigid_motion import Motion, exp
from tests.conftest import load

every_channel = pytest.mark.parametrize("channel", CHANNELS, ids=lambda c: c.name)
learned_channel = pytest.mark.parametrize("channel", [c for c in CHANNELS if c.n_out], ids=lambda c: c.name)


def poses(seed: int, n: int = 6, size: float = 0.4) -> Motion:
    random = np.random.default_rng(seed)
    return Motion(exp(size * random.uniform(-1, 1, (n, 3))), random.uniform(-1, 1, (n, 3)))


def moved(pose: Motion, by: np.ndarray) -> Motion:
    """by: (n, 6) rotation vectors in the target's frame and positions."""
    return Motion(pose.rotation @ exp(by[:, :3]), pose.translation + by[:, 3:])


def residual(channel: Channel, pose: Motion, values: np.ndarray) -> np.ndarray:
    """(n, rows), not whitened."""
    n = len(pose.translation)
    at = Measurements(np.arange(n), np.zeros((n, 0)), {channel.name: values}, {channel.name: np.ones(n)})
    return pose_residual(pose, at)


def test_the_registry():
    assert len({c.name for c in CHANNELS}) == len(CHANNELS)
    assert {c.name: c.human[0] for c in CHANNELS} == {name: unit for name, (unit, _) in SENSORS.items()}
    columns = [c for channel in CHANNELS for group in (channel.columns, *channel.other_columns) for c in group]
    assert len(set(columns)) == len(columns)
    assert set(BY_ROWS) == set(CHANNELS)
    units = [c.unit for c in BY_ROWS]
    assert units == sorted(units, reverse=True)  # angles first
    with pytest.raises(KeyError):
        named(["no channel"])


@every_channel
def test_the_sigma_of_robot_toml(channel):
    unit, usual = SENSORS[channel.name]
    factor = {"mm": 1e-3, "deg": np.pi / 180}[unit]
    assert not Sensor().given(channel.name)
    assert Sensor().sigma(channel.name) == pytest.approx(usual * factor, rel=1e-15)
    given = Sensor.model_validate({channel.field: 0.5})
    assert given.given(channel.name)
    assert given.stated(channel.name) == 0.5
    assert given.sigma(channel.name) == pytest.approx(0.5 * factor, rel=1e-15)


def test_tilt_and_yaw_are_an_orientation():
    assert parts(["orientation"]) == parts(["yaw", "tilt"]) == {"tilt", "yaw"}
    assert merged(["position", "yaw", "tilt"]) == (ORIENTATION, POSITION)
    assert merged(["tilt", "position"]) == (TILT, POSITION)
    assert merged(["yaw"]) == (YAW,)
    assert [all_turns(names) for names in (["orientation"], ["tilt", "yaw"], ["tilt"], ["yaw", "position"])] == [
        True,
        True,
        False,
        False,
    ]
    assert scored(["tilt", "yaw", "position"]) == {"rad": ORIENTATION, "m": POSITION}
    assert scored(["tilt"]) == {"rad": TILT}
    assert scored(["yaw"]) == {}


VALUES = {  # of Rz(yaw) Ry(pitch) Rx(roll) at (x, y, z)
    "orientation": lambda yaw, pitch, roll, at: Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], 1)).as_matrix(),
    "position": lambda yaw, pitch, roll, at: at,
    "tilt": lambda yaw, pitch, roll, at: np.stack([roll, pitch], axis=1),
    "yaw": lambda yaw, pitch, roll, at: yaw,
}


@pytest.mark.parametrize("name", VALUES)
def test_values_of_a_pose(name):
    random = np.random.default_rng(1)
    yaw, pitch, roll = random.uniform(-3, 3, 9), random.uniform(-1.5, 1.5, 9), random.uniform(-3, 3, 9)
    at = random.normal(size=(9, 3))
    rotation = Rotation.from_euler("xyz", np.stack([roll, pitch, yaw], axis=1)).as_matrix()
    (channel,) = named([name])
    np.testing.assert_allclose(channel.of(Motion(rotation, at)), VALUES[name](yaw, pitch, roll, at), atol=1e-12)


@every_channel
def test_a_residual_is_zero_where_it_was_measured_and_else_the_difference(channel):
    pose = poses(2)
    values = channel.of(pose)
    assert residual(channel, pose, values).shape == (6, channel.rows)
    assert channel.observed(values).shape == (6, channel.size)
    np.testing.assert_allclose(residual(channel, pose, values), 0, atol=1e-12)
    other = poses(3)
    if channel is ORIENTATION:
        expected = Rotation.from_matrix(np.swapaxes(values, 1, 2) @ other.rotation).as_rotvec()
    else:
        expected = (channel.of(other) - values).reshape(6, -1)
        if channel.unit == "rad":
            expected = (expected + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(residual(channel, other, values), expected, atol=1e-12)


@every_channel
def test_an_angle_residual_is_the_short_way_round(channel):
    """From one side of half a turn to the other."""
    if channel.unit == "m":
        return
    before, after = (exp(np.array([[0, 0, angle]])) for angle in (np.pi - 0.01, -np.pi + 0.01))
    nowhere = np.zeros((1, 3))
    found = residual(channel, Motion(after, nowhere), channel.of(Motion(before, nowhere)))
    assert np.abs(found).max() < 0.021


@every_channel
def test_exact_derivatives_of_the_residual(channel):
    """CasADi's against central differences, by the pose's rotation vector and position."""
    rotation, translation, by = ca.SX.sym("r", 3, 3), ca.SX.sym("t", 3), ca.SX.sym("by", 6)
    value = ca.SX.sym("value", channel.size)
    turned = rotation @ (ca.SX.eye(3) + ca.skew(by[:3]))
    row = channel.residual(turned, translation + by[3:], value)
    exact = ca.Function("exact", [rotation, translation, value, by], [ca.jacobian(row, by)])
    pose, values = poses(4), channel.of(poses(5))
    observed, h = channel.observed(values), 1e-6
    for k in range(6):
        found = np.array(exact(pose.rotation[k], pose.translation[k], observed[k], np.zeros(6)))
        for j, step in enumerate(np.eye(6) * h):
            ahead, behind = (residual(channel, moved(pose, sign * step[None]), values)[k] for sign in (1, -1))
            np.testing.assert_allclose(found[:, j], (ahead - behind) / (2 * h), atol=1e-8)


@every_channel
def test_what_shows_of_a_small_change(channel):
    """Against the scored error; a channel that is not scored, where it stands upright, against its values."""
    pose, h = poses(6), 1e-6
    if not channel.scored:
        pose = Motion(exp(np.outer(np.linspace(-1, 1, 6), [0, 0, 1])), pose.translation)
    shown = channel.change(np.tile(np.eye(6), (6, 1, 1)), pose.rotation)
    for j, step in enumerate(np.eye(6) * h):
        ahead, behind = (moved(pose, sign * np.tile(step, (6, 1))) for sign in (1, -1))
        if channel.scored:
            difference = channel.error(pose, ahead) - channel.error(pose, behind)
        else:
            difference = (channel.of(ahead) - channel.of(behind))[:, None]
        np.testing.assert_allclose(shown[:, :, j], difference / (2 * h), atol=1e-8)


@every_channel
def test_covariance_is_that_of_what_shows(channel):
    root = np.random.default_rng(7).normal(size=(6, 6, 6))
    covariance, pose = root @ root.swapaxes(1, 2), poses(7)
    shown = channel.change(np.tile(np.eye(6), (6, 1, 1)), pose.rotation)
    expected = shown @ covariance @ shown.swapaxes(1, 2)
    np.testing.assert_allclose(channel.covariance(covariance, pose.rotation), expected, atol=1e-12)


@every_channel
def test_a_table_brings_the_values_back(channel):
    values = channel.of(poses(8))
    columns = channel.write(values)
    assert tuple(columns) == channel.columns
    np.testing.assert_allclose(channel.read(pd.DataFrame(columns)), values, atol=1e-14)
    assert channel.wrong_row(columns) is None


@every_channel
def test_noise_has_the_sensor_s_sigma(channel):
    n, sigma = 20_000, 1e-3
    pose = Motion(np.tile(poses(9).rotation[0], (n, 1, 1)), np.zeros((n, 3)))
    read = channel.sensed(pose, 0.0)
    np.testing.assert_allclose(read, channel.of(pose), atol=1e-15)
    noisy = channel.noisy(read, sigma, np.random.default_rng(10))
    np.testing.assert_allclose(np.std(residual(channel, pose, noisy), axis=0), sigma, rtol=0.03)


@every_channel
def test_a_mistake_changes_the_values(channel):
    values = channel.of(poses(11))
    for cause, change in channel.mistakes():
        assert cause
        assert change(values).shape == values.shape
        assert np.abs(change(values) - values).max() > 0.1


@learned_channel
def test_a_chart_there_and_back(channel):
    """Tool poses that have nothing else in common get the same outputs; measured values give those of the tool."""
    loaded = load("gough_stewart")
    robot = loaded.model.robot(loaded.random_parameters(12))
    tool = poses(12, size=0.2)
    y = channel.outputs(robot, tool)
    assert y.shape == (6, channel.n_out)
    np.testing.assert_allclose(channel.outputs(robot, channel.put(robot, y, poses(13, size=0.2))), y, atol=1e-12)
    np.testing.assert_allclose(channel.outputs(robot, Motion(*(v[None] for v in _home(robot)))), 0, atol=1e-12)
    if channel is not ORIENTATION:  # which is charted as the whole tool pose
        measured = robot.measured(tool)
        found = channel.measured_outputs(robot, channel.of(measured), tool.rotation)
        np.testing.assert_allclose(found, y, atol=1e-12)


def _home(robot) -> tuple[np.ndarray, np.ndarray]:
    return robot.chain.home_pose.rotation, robot.chain.home_pose.translation
