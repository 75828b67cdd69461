"""The virtual robot against closed forms: its switches, statics, screws, noise and seeds."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.pipeline.results import Measured, Model, PosePlan
from kincal.pipeline.store.codec import encode
from kincal.pipeline.virtual.robot import VirtualRobot, draw
from kincal.pipeline.virtual.robot import measure as sense
from kincal.urdf.description import Sensor, VirtualErrors
from kincal.urdf.kinematics import forward
from kincal.urdf.rigid_motion import Motion

NO_FRAMES = {"frame_rotation_deg": 0.0, "frame_translation_mm": 0.0}
NOTHING = VirtualErrors(geometric=False, elastic=False, screw=False, **NO_FRAMES)

# ups3_s as its URDF draws it: legs from the base at radius 0.3 m to the platform at radius 0.2 m, turned by 45 degrees.
CENTRE = np.array([0.0, 0.0, 0.45])
AZIMUTH = np.deg2rad([0.0, 120.0, 240.0])
FEET = 0.3 * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH), np.zeros(3)], axis=1)
HEADS = 0.2 * np.stack([np.cos(AZIMUTH + np.pi / 4), np.sin(AZIMUTH + np.pi / 4), np.zeros(3)], axis=1)


@dataclass(frozen=True)
class Scene:
    model: Model
    plan: PosePlan
    nominal: ErrorModel
    readings: np.ndarray  # (n, 3)

    def robot(self, errors: VirtualErrors, seed: int = 0) -> VirtualRobot:
        return VirtualRobot.of(self.nominal, draw(self.nominal, errors, seed))


@pytest.fixture(scope="module")
def scene(start, tmp_path_factory) -> Scene:
    run, _ = start(tmp_path_factory.mktemp("virtual") / "store", "plan.poses=30", 'plan.layout="random"')
    model, plan = run.until("model", "plan")
    description = run.robot.description
    nominal = ErrorModel.of(model.chain(), description.actuator, description.tolerance)
    return Scene(model, plan, nominal, plan.table[list(description.actuated)].to_numpy())


def legs(rotation: np.ndarray) -> np.ndarray:
    """(n, 3, 3): from each foot to its head, at platform orientations (n, 3, 3)."""
    return CENTRE + np.einsum("nij,kj->nki", rotation, HEADS) - FEET


def lengths(pose: Motion) -> np.ndarray:
    return np.linalg.norm(legs(pose.rotation), axis=2)


def test_with_everything_off_it_is_the_drawing(scene):
    robot = scene.robot(NOTHING)
    assert not robot.truth.p.any()
    pose = robot.pose(scene.readings)
    nominal = forward(scene.nominal.chain, scene.readings).pose
    np.testing.assert_array_equal(pose.rotation, nominal.rotation)
    np.testing.assert_array_equal(pose.translation, nominal.translation)
    np.testing.assert_allclose(lengths(pose), scene.readings, atol=1e-11)


@pytest.mark.parametrize("switch", ["geometric", "elastic", "screw"])
def test_every_switch_moves_the_tool(scene, switch):
    moved = scene.robot(NOTHING.model_copy(update={switch: True})).pose(scene.readings)
    still = scene.robot(NOTHING).pose(scene.readings)
    angle = (Rotation.from_matrix(moved.rotation).inv() * Rotation.from_matrix(still.rotation)).magnitude()
    assert 1e-6 < angle.mean() < 3e-2


def test_frames_have_the_stated_size(scene):
    errors = VirtualErrors(geometric=False, elastic=False, screw=False)
    robot = scene.robot(errors).robot
    for frame in (robot.instrument, robot.target):
        assert np.rad2deg(Rotation.from_matrix(frame.rotation).magnitude()) == pytest.approx(errors.frame_rotation_deg)
        assert 1e3 * np.linalg.norm(frame.translation) == pytest.approx(errors.frame_translation_mm)


def test_geometric_errors_have_the_stated_tolerances(scene):
    parameters = scene.nominal.parameters
    drawn = np.array([draw(scene.nominal, VirtualErrors(), seed).p for seed in range(200)])[:, ~parameters.flat]
    ratio = drawn / parameters.tolerance[~parameters.flat]
    assert ratio.std() == pytest.approx(1.0, abs=0.02)
    assert abs(ratio.mean()) < 0.02


@pytest.mark.parametrize("centre", [(20.0, 10.0, 150.0), (-50.0, 80.0, 300.0)])
def test_deflection_is_that_of_statics(scene, centre):
    """Moments about the spherical joint: sum_i f_i r_i x s_i = c x m g z; a leg in compression f gives f / k."""
    errors = NOTHING.model_copy(update={"elastic": True, "payload_centre_mm": centre})
    pose = scene.robot(errors).pose(scene.readings)
    leg = legs(pose.rotation)
    arms = np.einsum("nij,kj->nki", pose.rotation, HEADS)
    moments = np.cross(arms, leg / np.linalg.norm(leg, axis=2, keepdims=True))  # of unit thrusts along the legs
    weight = np.array([0.0, 0.0, errors.payload_kg * 9.80665])
    load = np.cross(pose.rotation @ (np.array(centre) * 1e-3), weight)
    thrust = np.linalg.solve(moments.swapaxes(1, 2), load[..., None])[..., 0]
    expected = -thrust / errors.stiffness_n_per_m
    found = lengths(pose) - scene.readings
    assert np.abs(expected).max() > 1e-6
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-6 * np.abs(expected).max())


def test_weight_hangs_along_the_instruments_vertical(scene):
    """Turned about the vertical the instrument sees the same deflection; upside down, the opposite (to first order)."""
    errors = NOTHING.model_copy(update={"elastic": True})
    truth = scene.robot(errors).truth

    def bent(rotation_vector) -> np.ndarray:
        p = truth.p.copy()
        p[-9:-6] = rotation_vector  # W's rotation
        robot = VirtualRobot.of(scene.nominal, replace(truth, p=p))
        instrument = robot.robot.instrument
        base = instrument.inverse() @ robot.pose(scene.readings)
        return lengths(base) - scene.readings

    np.testing.assert_allclose(bent([0, 0, 1.0]), bent([0, 0, 0]), atol=1e-11)
    np.testing.assert_allclose(bent([np.pi, 0, 0]), -bent([0, 0, 0]), atol=1e-2 * np.abs(bent([0, 0, 0])).max())


def test_screw_errors_have_their_formula(scene):
    errors = NOTHING.model_copy(update={"screw": True})
    robot = scene.robot(errors)
    r = scene.readings
    home = np.linalg.norm(CENTRE + HEADS - FEET, axis=1)
    wave = 1e-3 * errors.screw_amplitude_mm * np.sin(2e3 * np.pi * r / errors.screw_period_mm + robot.truth.phase)
    expected = wave + errors.screw_quadratic_per_m * (r - home) ** 2
    np.testing.assert_allclose(lengths(robot.pose(r)) - r, expected, atol=3e-11)
    assert np.abs(expected).max() > 5e-6


def test_noise_has_the_stated_size():
    n, sensor = 20_000, Sensor(orientation_deg=0.01, position_mm=0.2, tilt_deg=0.03, yaw_deg=0.04)
    true = Motion(np.tile(Rotation.from_euler("ZYX", [0.3, 0.2, -0.1]).as_matrix(), (n, 1, 1)), np.ones((n, 3)))
    columns = sense(true, ("orientation", "position"), sensor, 0) | sense(true, ("tilt", "yaw"), sensor, 0)
    measured = Rotation.from_quat(np.stack([columns[c] for c in ("qx", "qy", "qz", "qw")], axis=1))
    turned = (Rotation.from_matrix(true.rotation).inv() * measured).as_rotvec()
    for values, sigma, mean in [
        (turned, np.deg2rad(sensor.orientation_deg), 0.0),
        (np.stack([columns[c] for c in "xyz"], axis=1), 1e-3 * sensor.position_mm, 1.0),
        (columns["roll"], np.deg2rad(sensor.tilt_deg), -0.1),
        (columns["pitch"], np.deg2rad(sensor.tilt_deg), 0.2),
        (columns["yaw"], np.deg2rad(sensor.yaw_deg), 0.3),
    ]:
        np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.03)
        np.testing.assert_allclose(values.mean(axis=0), mean, atol=5 * sigma / np.sqrt(n))


def test_only_the_channels_asked_for_are_measured(start, robot_folder, tmp_path):
    file = robot_folder / "robot.toml"
    file.write_text(file.read_text().partition("[measure.stream]")[0])
    for channels, columns in [
        ('["tilt"]', {"roll", "pitch"}),
        ('["tilt", "yaw"]', {"roll", "pitch", "yaw"}),
        ('["position"]', {"x", "y", "z"}),
    ]:
        run, _ = start(tmp_path / "store", "plan.poses=6", f"measure.channels={channels}", robot=file)
        assert set(run.until("measure")[0].table) == columns | {"pose", *run.robot.description.actuated}


def test_same_seed_same_bytes_other_seed_other_robot(start, tmp_path):
    def measured(store: str, seed: int) -> Measured:
        return start(tmp_path / store, "plan.poses=6", f"seed={seed}")[0].until("measure")[0]

    first, again, other = measured("a", 0), measured("b", 0), measured("a", 1)
    assert encode(first) == encode(again)
    assert not np.array_equal(first.truth.p, other.truth.p)
    assert not first.table.equals(other.table)


def test_noise_does_not_depend_on_the_errors(start, tmp_path):
    """A switch turned off changes the robot, and not what its sensor's noise or its geometric errors are."""
    run, _ = start(tmp_path / "store", "plan.poses=6")
    off, _ = start(tmp_path / "store", "plan.poses=6", "measure.errors.screw=false")
    first, second = run.until("measure")[0], off.until("measure")[0]
    np.testing.assert_array_equal(first.truth.p, second.truth.p)
    np.testing.assert_array_equal(first.truth.phase, second.truth.phase)
