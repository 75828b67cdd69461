"""The virtual robot's clearance, backlash, short screws, thermal growth and cross-axis error against closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.pipeline.results import Measured, Truth
from kincal.pipeline.stages.drawing import model_stage
from kincal.pipeline.stages.fresh_poses import fresh_poses as of_virtual_robot
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.pipeline.virtual.errors import Circumstances, approaches, clearance
from kincal.pipeline.virtual.robot import VirtualRobot, draw, stream_of
from kincal.pipeline.virtual.robot import measure as sense
from kincal.urdf.description import Sensor, Stream, VirtualErrors, load_robot
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import forward, tree
from kincal.urdf.rigid_motion import Motion

NOTHING = VirtualErrors(geometric=False, elastic=False, screw=False, frame_rotation_deg=0.0, frame_translation_mm=0.0)
ALL = ("orientation", "position", "tilt", "yaw")

# ups3_s as its URDF draws it: legs from the base at radius 0.3 m to the platform at radius 0.2 m, turned by 45 degrees.
CENTRE = np.array([0.0, 0.0, 0.45])
AZIMUTH = np.deg2rad([0.0, 120.0, 240.0])
FEET = 0.3 * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH), np.zeros(3)], axis=1)
HEADS = 0.2 * np.stack([np.cos(AZIMUTH + np.pi / 4), np.sin(AZIMUTH + np.pi / 4), np.zeros(3)], axis=1)
HOME = np.linalg.norm(CENTRE + HEADS - FEET, axis=1)


@dataclass(frozen=True)
class Scene:
    nominal: ErrorModel
    readings: np.ndarray  # (n, n_actuated)

    def robot(self, errors: VirtualErrors, seed: int = 0) -> VirtualRobot:
        return VirtualRobot.of(self.nominal, draw(self.nominal, errors, seed))


@pytest.fixture(scope="module")
def scene(robot) -> Scene:
    loaded = robot("ups3_s")
    return Scene(loaded.model, loaded.readings(60, 1))


@pytest.fixture(scope="module")
def arm(robot) -> Scene:
    """Revolute actuators."""
    loaded = robot("ur10")
    return Scene(loaded.model, loaded.readings(30, 1))


@pytest.fixture(scope="module")
def measured(start, tmp_path_factory):
    """measured(setting, ..) -> what the pipeline's virtual ups3_s measures; the plan is shared."""
    folder = tmp_path_factory.mktemp("virtual") / "store"

    def measured(*settings: str) -> Measured:
        return start(folder, "plan.poses=20", *settings)[0].until("measure")[0]

    return measured


def of(**sizes) -> VirtualErrors:
    return NOTHING.model_copy(update=sizes)


def legs(pose: Motion) -> np.ndarray:
    """(n, 3, 3): from each foot to its head."""
    return CENTRE + np.einsum("nij,kj->nki", pose.rotation, HEADS) - FEET


def shift(pose: Motion, readings: np.ndarray) -> np.ndarray:
    """(n, 3) by how much each leg is longer than its reading."""
    return np.linalg.norm(legs(pose), axis=2) - readings


def thrust(pose: Motion, errors: VirtualErrors) -> np.ndarray:
    """(n, 3) compression of each leg by statics: sum_i f_i r_i x s_i = c x m g z about the spherical joint."""
    leg, arms = legs(pose), np.einsum("nij,kj->nki", pose.rotation, HEADS)
    moments = np.cross(arms, leg / np.linalg.norm(leg, axis=2, keepdims=True))
    load = np.cross(pose.rotation @ (np.array(errors.payload_centre_mm) * 1e-3), [0.0, 0.0, errors.payload_kg * 9.8])
    return np.linalg.solve(moments.swapaxes(1, 2), load[..., None])[..., 0]


def arm_moves_as(arm: Scene, found: Motion, shifts: np.ndarray) -> None:
    expected = forward(arm.nominal.chain, arm.nominal.actuators.joints(arm.readings) + shifts).pose
    assert np.abs(shifts).max() > 1e-6
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, expected.translation, atol=1e-12)


def test_the_draws_of_earlier_versions_have_not_changed(scene):
    """Figures of the version that had none of these errors."""
    truth = draw(scene.nominal, VirtualErrors(), 3)
    assert truth.p[:3].tolist() == [5.2660810408306404e-06, -1.5301333145339684e-04, -5.5480045521484828e-04]
    assert truth.p[-2:] == pytest.approx([0.00222195401056103, -0.01372060778873878], rel=1e-14)
    assert truth.phase == pytest.approx([1.536825203340175, 4.279698708970033, 1.9600885905359222], rel=1e-14)
    pose = VirtualRobot.of(scene.nominal, truth).pose(np.array([[0.48, 0.5, 0.49], [0.5, 0.47, 0.51]]))
    columns = sense(pose, ("orientation", "position"), Sensor(), 3) | sense(pose, ("tilt", "yaw"), Sensor(), 3)
    stream = stream_of(pose, ("tilt", "yaw"), Sensor(), Stream(rate_hz=2, seconds=2, outliers=0.2), 3)
    for found, expected in [
        (columns["qx"], [-0.0069323079826443925, -0.034077348954396416]),
        (columns["z"], [0.44738769528726713, 0.4455396697785859]),
        (columns["roll"], [-0.01690230688704681, -0.06472691337034778]),
        (columns["yaw"], [-0.10793107823167132, -0.061110699369508775]),
        (stream["pitch"][-3:], [-0.12302296491931329, -0.12337815037535413, -0.08776745446000517]),
        (stream["yaw"][-3:], [-0.06088961888381926, -0.060643128746652876, -0.06124254056161689]),
    ]:
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("errors", [VirtualErrors(), NOTHING])
def test_circumstances_change_no_bit_where_the_new_errors_are_off(scene, errors):
    robot = scene.robot(errors)
    before = robot.pose(scene.readings)
    for circumstances in (robot.campaign(scene.readings), robot.after_campaign(scene.readings)):
        after = robot.pose(scene.readings, circumstances)
        assert before.rotation.tobytes() == after.rotation.tobytes()
        assert before.translation.tobytes() == after.translation.tobytes()


def test_clearance_is_half_its_play_in_the_direction_of_the_load(scene):
    errors = of(clearance_mm=0.02)
    compression = thrust(scene.robot(NOTHING).pose(scene.readings), errors)
    assert (compression > 0).any()
    assert (compression < 0).any()  # or nothing flips
    found = shift(scene.robot(errors).pose(scene.readings), scene.readings)
    np.testing.assert_allclose(found, -1e-5 * np.sign(compression), atol=2e-11)


def test_clearance_needs_a_load(scene):
    found = shift(scene.robot(of(clearance_mm=0.02, payload_kg=0.0)).pose(scene.readings), scene.readings)
    np.testing.assert_allclose(found, 0.0, atol=2e-11)


def test_a_load_that_is_rounding_closes_no_gap():
    found = clearance(of(clearance_mm=0.02), np.array([True, True, True]), np.array([[1e-13, -1e-13, 1e-3]]))
    np.testing.assert_allclose(found, [[0.0, 0.0, 1e-5]])


def test_clearance_comes_on_top_of_elasticity(scene):
    elastic = shift(scene.robot(of(elastic=True)).pose(scene.readings), scene.readings)
    play = shift(scene.robot(of(clearance_mm=0.02)).pose(scene.readings), scene.readings)
    both = shift(scene.robot(of(elastic=True, clearance_mm=0.02)).pose(scene.readings), scene.readings)
    np.testing.assert_allclose(both, elastic + play, atol=1e-3 * np.abs(elastic).max())


def test_clearance_of_revolute_actuators(arm):
    """An arm's joint carries no load where turning it does not lift the payload: here by finite differences."""
    errors = of(clearance_deg=0.02, clearance_mm=5.0)
    chain, joints = arm.nominal.chain, arm.nominal.actuators.joints(arm.readings)
    centre = chain.tool.rotation @ (np.array(errors.payload_centre_mm) * 1e-3) + chain.tool.translation

    def height(actuated: np.ndarray) -> np.ndarray:
        up = chain.base.rotation[:, 2]
        return tree(chain, forward(chain, actuated).q).point(chain.tool_joint, centre) @ up

    steps = 1e-4 * np.eye(joints.shape[1])
    lifted = np.stack([height(joints + step) - height(joints - step) for step in steps], axis=1) / 2e-4
    direction = np.where(np.abs(lifted) > 1e-8, -np.sign(lifted), 0.0)
    assert {-1.0, 0.0, 1.0} == set(direction.ravel())  # the first axis is vertical
    arm_moves_as(arm, arm.robot(errors).pose(arm.readings), np.deg2rad(0.01) * direction)


def test_backlash_lags_behind_the_last_motion(scene):
    robot = scene.robot(of(backlash_mm=0.02))
    motion = np.diff(np.vstack([HOME, scene.readings]), axis=0)
    there = shift(robot.pose(scene.readings, robot.campaign(scene.readings)), scene.readings)
    np.testing.assert_allclose(there, -1e-5 * np.sign(motion), atol=2e-11)
    back = scene.readings[::-1]  # the same poses, approached from the other side
    returned = shift(robot.pose(back, robot.after_campaign(back)), back)[::-1]
    np.testing.assert_allclose(returned[:-1], -there[1:], atol=2e-11)
    np.testing.assert_allclose(shift(robot.pose(back), back), 0.0, atol=2e-11)


def test_an_actuator_that_rests_keeps_its_last_approach():
    joints = np.array([[0.0, 0.1], [0.1, 0.1], [0.1, 0.2 + 1e-12], [0.1 + 1e-12, 0.2], [np.nan, 0.1], [0.0, 0.3]])
    expected = [[0, 1], [1, 1], [1, 1], [1, 1], [1, -1], [1, 1]]  # a pose that is not to be had leaves all as it was
    np.testing.assert_array_equal(approaches(joints, np.zeros(2)), expected)
    assert approaches(np.zeros((0, 2)), np.zeros(2)).shape == (0, 2)


def test_approach_is_that_of_the_joint_and_not_of_its_reading(scene):
    """A zero that is off, or a gain below 0, does not turn a motion around."""
    robot = scene.robot(of(backlash_mm=0.02))
    actuators = replace(robot.robot.actuators, gain=-robot.robot.actuators.gain, zero=robot.robot.actuators.zero + 1e-3)
    mirrored = replace(robot, robot=replace(robot.robot, actuators=actuators), home_readings=-robot.home_readings)
    np.testing.assert_array_equal(mirrored.campaign(-scene.readings).approach, robot.campaign(scene.readings).approach)


def test_no_motion_leads_from_home_to_home(scene):
    """Though the robot as built is not where the drawing has it."""
    robot = scene.robot(VirtualErrors())
    approach = robot.campaign(np.stack([HOME, HOME, HOME + 1e-6])).approach
    np.testing.assert_array_equal(approach, [[0, 0, 0], [0, 0, 0], [1, 1, 1]])


def test_backlash_of_revolute_actuators(arm):
    robot, chain = arm.robot(of(backlash_deg=0.02, backlash_mm=5.0)), arm.nominal.chain
    motion = np.diff(np.vstack([chain.home[chain.actuated], arm.nominal.actuators.joints(arm.readings)]), axis=0)
    arm_moves_as(arm, robot.pose(arm.readings, robot.campaign(arm.readings)), -np.deg2rad(0.01) * np.sign(motion))


@pytest.mark.parametrize("period", [2.0, 3.0, 5.0, 80.0])
def test_a_screw_of_any_period_has_its_formula(scene, period):
    errors = of(screw=True, screw_period_mm=period, screw_quadratic_per_m=0.0, screw_amplitude_mm=0.01)
    robot = scene.robot(errors)
    wave = 1e-5 * np.sin(2e3 * np.pi * scene.readings / period + robot.truth.phase)
    np.testing.assert_allclose(shift(robot.pose(scene.readings), scene.readings), wave, atol=2e-11)
    assert wave.min() < -0.9e-5  # the poses see both crests
    assert wave.max() > 0.9e-5


def test_thermal_growth_is_linear_over_the_campaign(scene):
    robot, n = scene.robot(of(thermal_growth_mm=0.05)), len(scene.readings)
    found = shift(robot.pose(scene.readings, robot.campaign(scene.readings)), scene.readings)
    np.testing.assert_allclose(found, 5e-5 * np.arange(n)[:, None] / (n - 1) * robot.truth.growth_sign, atol=2e-11)
    warm = shift(robot.pose(scene.readings, robot.after_campaign(scene.readings)), scene.readings)
    np.testing.assert_allclose(warm, np.tile(5e-5 * robot.truth.growth_sign, (n, 1)), atol=2e-11)


def test_thermal_growth_of_revolute_actuators(arm):
    robot = arm.robot(of(thermal_growth_deg=0.05, thermal_growth_mm=5.0))
    half = Circumstances(np.zeros_like(arm.readings), np.full(len(arm.readings), 0.5))
    shifts = np.deg2rad(0.025) * np.tile(robot.truth.growth_sign, (len(arm.readings), 1))
    arm_moves_as(arm, robot.pose(arm.readings, half), shifts)


def test_every_actuator_may_grow_either_way(scene):
    signs = np.array([draw(scene.nominal, VirtualErrors(), seed).growth_sign for seed in range(50)])
    assert set(signs.ravel()) == {-1.0, 1.0}
    assert (np.abs(signs.mean(axis=0)) < 0.5).all()


def test_terms_without_load_add_up(scene):
    sizes = ({"backlash_mm": 0.02}, {"thermal_growth_mm": 0.05}, {"screw": True})
    robots = [scene.robot(of(**size)) for size in sizes]
    alone = [shift(r.pose(scene.readings, r.campaign(scene.readings)), scene.readings) for r in robots]
    together = scene.robot(of(**{k: v for size in sizes for k, v in size.items()}))
    found = shift(together.pose(scene.readings, together.campaign(scene.readings)), scene.readings)
    np.testing.assert_allclose(found, sum(alone), atol=5e-11)


def test_cross_axis_leaks_angles_into_each_other(scene):
    pose, c = scene.robot(VirtualErrors()).pose(scene.readings), 1e-3
    true = Rotation.from_matrix(pose.rotation).as_euler("ZYX")[:, ::-1]  # roll, pitch, yaw
    expected = c * np.stack([true[:, 1], true[:, 0], true[:, 0]], axis=1)
    stream = Stream(rate_hz=10, seconds=1)
    for leaked in (
        lambda c: sense(pose, ("tilt", "yaw"), Sensor(), 0, c),
        lambda c: stream_of(pose, ("tilt", "yaw"), Sensor(), stream, 0, c).groupby("pose").mean(),
    ):
        off, on = leaked(0.0), leaked(c)  # the same noise
        found = np.stack([on[name] - off[name] for name in ("roll", "pitch", "yaw")], axis=1)
        np.testing.assert_allclose(found, expected, atol=1e-14)


def test_cross_axis_turns_a_tracker_since_its_first_pose(scene):
    pose, c = scene.robot(VirtualErrors()).pose(scene.readings), 1e-3
    columns = sense(pose, ("orientation", "position"), Sensor(orientation_deg=1e-9), 0, c)
    read = Rotation.from_quat(np.stack([columns[k] for k in ("qx", "qy", "qz", "qw")], axis=1))
    true = Rotation.from_matrix(pose.rotation)
    x, y, z = (true[0].inv() * true).as_rotvec().T
    expected = np.stack([x + c * y, y + c * x, z + c * x], axis=1)
    np.testing.assert_allclose((true[0].inv() * read).as_rotvec(), expected, atol=3e-10)
    assert np.abs(expected - np.stack([x, y, z], axis=1)).max() > 1e-4
    exact = sense(pose, ("orientation", "position"), Sensor(orientation_deg=1e-9), 0)
    np.testing.assert_array_equal([columns[k] for k in "xyz"], [exact[k] for k in "xyz"])


def test_both_instruments_have_the_same_axes():
    """For small turns since an upright first pose, a tracker's Euler angles are what an inclinometer reads."""
    angles = 1e-4 * np.random.default_rng(0).normal(size=(20, 3))  # yaw, pitch, roll
    angles[0] = 0.0
    pose = Motion(Rotation.from_euler("ZYX", angles).as_matrix(), np.zeros((20, 3)))
    still = Sensor(orientation_deg=1e-12, tilt_deg=1e-12, yaw_deg=1e-12)
    columns = sense(pose, ("orientation",), still, 0, 0.1) | sense(pose, ("tilt", "yaw"), still, 0, 0.1)
    tracked = Rotation.from_quat(np.stack([columns[k] for k in ("qx", "qy", "qz", "qw")], axis=1)).as_euler("ZYX")
    read = np.stack([columns[k] for k in ("yaw", "pitch", "roll")], axis=1)
    np.testing.assert_allclose(tracked, read, atol=2e-8)
    assert np.abs(read - angles).max() > 1e-5


@pytest.mark.parametrize("channels", ['["orientation"]', '["tilt", "yaw"]'])
def test_cross_axis_is_in_the_measurements_and_not_in_the_truth(measured, scene, robot, channels):
    off, on = (measured(f"measure.channels={channels}", f"measure.errors.cross_axis={c}") for c in (0.0, 1e-3))
    for name in ("p", "phase", "growth_sign"):
        np.testing.assert_array_equal(getattr(off.truth, name), getattr(on.truth, name))
    before, after = ((m.table if m.stream is None else m.stream).drop(columns="pose") for m in (off, on))
    moved = (after - before).abs().max()
    assert (moved[moved.index.str.match("q|roll|pitch|yaw")] > 1e-6).all()
    np.testing.assert_array_equal(*(fresh_poses(m.truth, robot)[1].rotation for m in (off, on)))


def test_the_pipeline_measures_the_robot_as_it_warms_up_and_scores_it_warm(measured, scene, robot):
    cold, grown = measured(), measured("measure.errors.thermal_growth_mm=0.05")
    turned = (quaternions(cold).inv() * quaternions(grown)).magnitude()
    assert turned[0] == 0.0
    assert turned[-1] > 1e-5
    assert np.corrcoef(turned, np.arange(len(turned)))[0, 1] > 0.9
    at, pose = fresh_poses(grown.truth, robot)
    virtual = VirtualRobot.of(scene.nominal, grown.truth)
    warm = Circumstances(np.zeros_like(at), np.ones(len(at)))
    np.testing.assert_array_equal(pose.rotation, virtual.pose(at, warm).rotation)
    assert not np.array_equal(pose.rotation, virtual.pose(at).rotation)


def test_the_pipeline_takes_the_rows_of_its_lists_one_after_the_other(measured, scene, robot):
    """Measured and scored alike: every row's backlash is that of the motion from the row before."""
    none, lost = (
        measured(f"measure.errors.backlash_mm={b}", "measure.errors.elastic=false", "sensor.orientation_deg=1e-9")
        for b in (0.0, 0.02)
    )
    readings = lost.table[["leg1_slide", "leg2_slide", "leg3_slide"]].to_numpy()
    virtual = VirtualRobot.of(scene.nominal, lost.truth)
    approach = np.sign(np.diff(np.vstack([HOME, readings]), axis=0))
    expected = virtual.pose(readings, Circumstances(approach, np.zeros(len(readings)))).rotation
    np.testing.assert_allclose(quaternions(lost).as_matrix(), expected, atol=1e-9)
    assert (quaternions(none).inv() * quaternions(lost)).magnitude().max() > 1e-5
    at, pose = fresh_poses(lost.truth, robot)
    approach = np.sign(np.diff(np.vstack([HOME, at]), axis=0))
    expected = virtual.pose(at, Circumstances(approach, np.zeros(len(at))))
    np.testing.assert_allclose(pose.rotation, expected.rotation, atol=1e-12)


@pytest.mark.parametrize(
    ("setting", "allowed"),
    [
        ("clearance_mm=-0.01", "greater than or equal to 0"),
        ("backlash_deg=nan", "finite"),
        ('thermal_growth_mm="warm"', "number"),
        ("cross_axis=0.5", "less than 0.5"),
        ("backlash=0.1", "backlash_mm"),
    ],
)
def test_bad_sizes_are_refused_in_one_line(setting, allowed):
    with pytest.raises(InputError) as error:
        load_robot("ups3_s", [f"measure.errors.{setting}"])
    message = str(error.value)
    assert "\n" not in message
    assert f"--set measure.errors.{setting}" in message or f"measure.errors.{setting.split('=')[0]}" in message
    assert allowed in message


def quaternions(measured: Measured) -> Rotation:
    return Rotation.from_quat(measured.table[["qx", "qy", "qz", "qw"]].to_numpy())


def fresh_poses(truth: Truth, robot) -> tuple[np.ndarray, Motion]:
    """Readings of poses that a method is scored on, and the truth there."""
    description = robot("ups3_s").description
    drawn = DrawnRobot.of(model_stage(description.mechanism, description.urdf), description)
    at, pose = of_virtual_robot(drawn, truth, 40, 0)
    return at.readings, pose
