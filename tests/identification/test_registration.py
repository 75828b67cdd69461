"""W and T of any size, recovered by registration from noise-free measurements of a robot that is as drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.estimators import register
from kincal.identification.registration import starts
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion

SEEDS = range(20)


def random_motion(random: np.random.Generator) -> Motion:
    """A rotation anywhere on the sphere (up to 180 degrees), and metres of offset."""
    return Motion(Rotation.random(rng=random).as_matrix(), random.uniform(-3, 3, 3))


def registered(loaded, measured) -> tuple[Motion, Motion]:
    found = register(loaded.model, measured)
    assert found.success
    assert np.all(found.p[:-12] == 0)
    robot = loaded.model.robot(found.p)
    return robot.instrument, robot.target


def assert_same(found: Motion, true: Motion, what=("rotation", "translation"), tolerance: float = 1e-8) -> None:
    for part in what:
        np.testing.assert_allclose(getattr(found, part), getattr(true, part), rtol=0, atol=tolerance)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ["jugglebot", "ur10"])
def test_orientation_and_position(name, seed, robot):
    """Both motions are determined, all twelve numbers."""
    loaded, random = robot(name), np.random.default_rng(seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    measured = loaded.measure(p, loaded.readings(20, seed), ("orientation", "position"))
    found_w, found_t = registered(loaded, measured)
    assert_same(found_w, w)
    assert_same(found_t, t)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("channels", [("orientation",), ("tilt", "yaw")], ids="+".join)
def test_orientation_alone(channels, seed, robot):
    """Both rotations; translations are not seen."""
    loaded, random = robot("ups3_s"), np.random.default_rng(100 + seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    found_w, found_t = registered(loaded, loaded.measure(p, loaded.readings(12, seed), channels))
    assert_same(found_w, w, ["rotation"])
    assert_same(found_t, t, ["rotation"])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", ["jugglebot", "ur10"])
def test_position_alone(name, seed, robot):
    """W whole and T's offset; T's rotation moves no point."""
    loaded, random = robot(name), np.random.default_rng(200 + seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    found_w, found_t = registered(loaded, loaded.measure(p, loaded.readings(25, seed), ("position",)))
    assert_same(found_w, w)
    assert_same(found_t, t, ["translation"])


@pytest.mark.parametrize("seed", SEEDS)
def test_tilt_alone(seed, robot):
    """T's rotation, and of W's all but its turn about gravity: the vertical in the base frame."""
    loaded, random = robot("ups3_s"), np.random.default_rng(300 + seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    found_w, found_t = registered(loaded, loaded.measure(p, loaded.readings(20, seed), ("tilt",)))
    assert_same(found_t, t, ["rotation"])
    np.testing.assert_allclose(found_w.rotation[2], w.rotation[2], rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_tilt_and_position(seed, robot):
    """Everything again: positions give the heading that tilt lacks."""
    loaded, random = robot("jugglebot"), np.random.default_rng(400 + seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    found_w, found_t = registered(loaded, loaded.measure(p, loaded.readings(20, seed), ("tilt", "position")))
    assert_same(found_w, w)
    assert_same(found_t, t)


def along(loaded, axes: tuple[int, ...], n: int = 12) -> np.ndarray:
    """Readings of poses that move along some of the tool's axes alone."""
    u = np.zeros((n, 6))
    u[:, axes] = loaded.coordinates(n, 1)[:, axes]
    closure = inverse(loaded.chain, u)
    assert closure.closed.all()
    return loaded.model.actuators.readings(closure.q[:, loaded.chain.actuated])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "name, axes, channels",
    [
        ("ups3_s", (3,), ("orientation",)),
        ("ups3_s", (5,), ("tilt",)),
        ("ur10", (3,), ("orientation", "position")),
        ("ur10", (0, 1, 2), ("orientation", "position")),
        ("jugglebot", (0, 1, 2), ("orientation", "position")),
        ("jugglebot", (5,), ("orientation", "position")),
    ],
)
def test_poses_about_a_single_axis_or_of_pure_translation(name, axes, channels, seed, robot):
    """W and T are not unique there, their predictions of these poses are: they must fit."""
    loaded, random = robot(name), np.random.default_rng(500 + seed)
    w, t = random_motion(random), random_motion(random)
    p = loaded.model.with_frames(np.zeros(len(loaded.model.parameters)), w, t)
    readings = along(loaded, axes)
    measured = loaded.measure(p, readings, channels)
    found_w, found_t = registered(loaded, measured)
    tool = loaded.model.robot(np.zeros(len(p))).close(readings).pose
    predicted, true = found_w @ tool @ found_t, w @ tool @ t
    if "position" in channels:
        assert_same(predicted, true, ["translation"])
    if "orientation" in channels:
        assert_same(predicted, true, ["rotation"])
    else:
        np.testing.assert_allclose(predicted.rotation[:, 2], true.rotation[:, 2], rtol=0, atol=1e-8)


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_poses(n, robot):
    loaded = robot("jugglebot")
    readings = loaded.readings(n, 0)
    measured = loaded.measure(loaded.random_parameters(0), readings, ("orientation", "position"))
    tool = loaded.model.robot(np.zeros(len(loaded.model.parameters))).close(readings).pose
    for attempt in (lambda: starts(tool, measured), lambda: register(loaded.model, measured)):
        with pytest.raises(InputError, match=rf"{n} poses can't register W and T; at least 3"):
            attempt()


def test_registration_that_cannot_converge_says_so(robot):
    """One iteration from noisy data is not enough, and no answer is passed off as one."""
    loaded = robot("ups3_s")
    noise = np.random.default_rng(0)
    p = loaded.random_parameters(3, 10.0)
    measured = loaded.measure(p, loaded.readings(12, 1), ("orientation",), {"orientation": 1e-6}, noise)
    with pytest.raises(CalibrationError, match="did not converge"):
        register(loaded.model, measured, max_iterations=1)
