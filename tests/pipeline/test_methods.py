"""Charts of the networks' outputs, methods and their inverses, and commands that are refused."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from kincal.identification.accuracy import gravity_error
from kincal.learning.network import Network
from kincal.learning.transfer import new_network, train
from kincal.pipeline.compensator.commands import commands
from kincal.pipeline.compensator.goal import WHOLE
from kincal.pipeline.compensator.solvers import Solvers
from kincal.pipeline.learned import Corrected, Learned
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.methods.predictors import METHODS, HybridMethod, ModelMethod, NetworkMethod, build
from kincal.pipeline.results import Fit
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import forward, inverse, pose_at, tool_coordinates
from kincal.urdf.rigid_motion import Motion, log

KINDS = [
    ("ups3_s", ("orientation",)),
    ("ups3_s", ("tilt",)),
    ("ups3_s", ("tilt", "yaw")),
    ("jugglebot", ("position",)),
    ("jugglebot", ("orientation", "position")),
    ("jugglebot", ("tilt", "position")),
    ("jugglebot", ("tilt", "yaw", "position")),
]
FULL = [kind for kind in KINDS if "orientation" in kind[1] or "yaw" in kind[1]]


def ids(kind) -> str:
    return f"{kind[0]}-{'+'.join(kind[1])}"


def frame(vector) -> Motion:
    """A motion of any size: metres, and a rotation vector of up to half a turn about each axis."""
    return Motion.from_vector(np.array(vector))


FRAMES = st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6).map(frame)


@dataclass(frozen=True)
class Known:
    """A robot (as known) and another one (as built) that measures, both in the same measurement frame."""

    chart: Chart
    built: object
    readings: np.ndarray
    measured: object


def known(robot, kind, instrument: Motion, target: Motion, n: int = 8) -> Known:
    loaded = robot(kind[0])
    readings = loaded.readings(n, seed=4)
    exact = loaded.random_parameters(1, tolerances=0.0, instrument=instrument, target=target)
    off = loaded.random_parameters(2, tolerances=3.0, instrument=instrument, target=target)
    measured = loaded.measure(off, readings, kind[1])
    return Known(Chart(loaded.model.robot(exact), kind[1]), loaded.model.robot(off), readings, measured)


# Charts


@pytest.mark.parametrize("kind", KINDS, ids=ids)
@given(instrument=FRAMES, target=FRAMES)
def test_a_measured_pose_comes_back(robot, kind, instrument, target):
    """There and back: what was measured of a robot unlike the model is met again, with W and T of any size."""
    case = known(robot, kind, instrument, target, n=4)
    wanted = case.measured.as_poses()
    y = case.chart.of_measured(case.measured, wanted)
    assert y.shape == (4, case.chart.n_out)
    back = case.chart.pose(y, case.readings)
    if case.chart.full:
        np.testing.assert_allclose(back.rotation, wanted.rotation, atol=1e-11)
    elif case.chart.tilt:
        assert np.abs(gravity_error(wanted.rotation, back.rotation)).max() < 1e-8
    if case.chart.moved:
        np.testing.assert_allclose(back.translation, wanted.translation, atol=1e-11)


@pytest.mark.parametrize("kind", KINDS, ids=ids)
@given(instrument=FRAMES, target=FRAMES)
def test_source_and_target_task_are_the_same_function(robot, kind, instrument, target):
    """The outputs of a pose measured without error, against those of the same tool pose computed in the base frame."""
    loaded = robot(kind[0])
    readings = loaded.readings(4, seed=5)
    p = loaded.random_parameters(3, instrument=instrument, target=target)
    built = loaded.model.robot(p)
    chart = Chart(built, kind[1])
    measured = loaded.measure(p, readings, kind[1])
    y = chart.of_measured(measured, measured.as_poses())
    np.testing.assert_allclose(y, chart.of_tool(built.close(readings).pose), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS, ids=ids)
def test_outputs_are_regular_about_home(robot, kind):
    """Small at home and smooth around it: the change of outputs is linear in a small change of the tool's pose."""
    loaded = robot(kind[0])
    chart = Chart(loaded.model.robot(loaded.random_parameters(6, instrument=frame([0.3, 0.2, 1, 2.5, 1, -1]))), kind[1])
    axes, n = list(loaded.chain.tool_axes), len(loaded.chain.tool_axes)
    u = np.zeros((2 * n + 1, 6))
    u[1:, axes] = 1e-4 * np.concatenate([np.eye(n), -np.eye(n)])
    y = chart.of_tool(pose_at(loaded.chain, u))
    assert np.abs(y[0]).max() < 1e-12
    np.testing.assert_allclose(y[1 : n + 1], -y[n + 1 :], atol=2e-8)
    assert np.linalg.matrix_rank(y[1 : n + 1], tol=1e-6) == min(chart.n_out, n)


def test_tilt_alone_takes_the_heading_from_the_model(robot):
    """The orientation filled in is the model's, turned by the least angle that meets the measured vertical."""
    case = known(robot, ("ups3_s", ("tilt",)), frame([0.1, 0, 0, 0.4, 0.5, 2]), frame([0, 0, 0.1, 0.2, -0.9, 1]))
    wanted = case.measured.as_poses()
    back = case.chart.pose(case.chart.of_measured(case.measured, wanted), case.readings)
    model = case.chart.robot.measured(case.chart.robot.close(case.readings).pose)
    turned = np.linalg.norm(log(model.rotation.swapaxes(1, 2) @ back.rotation), axis=1)
    least = np.linalg.norm(gravity_error(wanted.rotation, model.rotation), axis=1)
    assert least.min() > 1e-5
    np.testing.assert_allclose(turned, least, rtol=1e-6)


# Methods


def hybrid(loaded, p: np.ndarray, correction) -> HybridMethod:
    """With a refined geometry a third of its tolerance off the identified one."""
    refined = p + 0.3 * loaded.random_parameters(8) * (np.arange(len(p)) < len(p) - 12)
    return HybridMethod(ModelMethod(loaded.model.robot(p)), loaded.model.robot(refined), correction)


def trained(chart: Chart, readings: np.ndarray) -> Network:
    """A network that has roughly learned the source task."""
    task = chart.of_tool(chart.robot.close(readings).pose)
    start = new_network(readings, task, 8, seed=0)
    options = {"validation": 0.1, "iterations": 25, "seed": 0}
    return train([start], readings, [task], [np.arange(len(readings))], **options)[0][0]


@pytest.fixture(scope="module")
def desired(robot):
    """desired(name, p): eight poses in the workspace of a robot with parameters p, in its measurement frame."""

    def desired(name: str, p: np.ndarray) -> Motion:
        loaded = robot(name)
        return loaded.model.robot(p).measured(pose_at(loaded.chain, 0.9 * loaded.coordinates(8, seed=12)))

    return desired


def assert_reached(loaded, method, wanted: Motion, translates: bool) -> np.ndarray:
    readings, reached = loaded.command(method, wanted)
    assert reached.all()
    got = method.predict(readings)
    np.testing.assert_allclose(got.rotation, wanted.rotation, atol=1e-9)
    if translates:
        np.testing.assert_allclose(got.translation, wanted.translation, atol=1e-9)
    return readings


@pytest.mark.parametrize("name", ["ups3_s", "jugglebot", "ur10"])
def test_a_model_reaches_what_it_is_commanded(robot, desired, name):
    """Prediction at the command against the desired pose."""
    loaded = robot(name)
    p = loaded.random_parameters(7, instrument=frame([0.5, 0.1, 0.2, 1.0, -2.0, 0.5]))
    assert_reached(loaded, ModelMethod(loaded.model.robot(p)), desired(name, p), 0 in loaded.chain.tool_axes)


@pytest.mark.parametrize("size", [1e-4, 3e-3], ids=["small correction", "large correction"])
@pytest.mark.parametrize("shrinkage, hull", [(1.0, 9.0), (0.6, 0.7)], ids=["whole", "in part"])
@pytest.mark.parametrize("name", ["ups3_s", "jugglebot", "ur10"])
def test_hybrid_reaches_what_it_is_commanded(robot, desired, correction, name, size, shrinkage, hull):
    """Prediction at the command against the desired pose; also where the correction is believed in part."""
    loaded = robot(name)
    p = loaded.random_parameters(7, instrument=frame([0.5, 0.1, 0.2, 1.0, -2.0, 0.5]))
    method = hybrid(loaded, p, correction(loaded, size, shrinkage, hull))
    readings = assert_reached(loaded, method, desired(name, p), 0 in loaded.chain.tool_axes)
    share = method.correction.share(readings)
    assert np.all(share <= shrinkage)
    assert np.any((share > 0) & (share < 1)) == (shrinkage < 1)
    apart = np.abs(readings - loaded.command(method.geometric, desired(name, p))[0]).max(axis=1)
    assert np.all(apart[share > 0.1] > 1e-7)


@pytest.mark.parametrize("channels", [("orientation",), ("tilt", "yaw"), ("tilt",)], ids="+".join)
def test_a_network_reaches_what_it_is_commanded(robot, desired, channels):
    """Prediction at the command against the desired pose (its vertical, where a heading was never measured)."""
    loaded = robot("ups3_s")
    p = loaded.random_parameters(7, instrument=frame([0.5, 0.1, 0.2, 1.0, -0.4, 0.5]))
    chart = Chart(loaded.model.robot(p), channels)
    method = NetworkMethod(trained(chart, loaded.readings(125, seed=8)), chart)
    wanted = desired("ups3_s", p)
    readings, reached = loaded.command(method, wanted)
    assert reached.all()
    got = method.predict(readings)
    if chart.tilt:
        assert np.abs(gravity_error(wanted.rotation, got.rotation)).max() < 1e-9
    else:
        np.testing.assert_allclose(got.rotation, wanted.rotation, atol=1e-9)


def test_a_network_of_a_robot_that_translates(robot, desired):
    """All six coordinates of Jugglebot's tool."""
    loaded = robot("jugglebot")
    p = loaded.random_parameters(7, instrument=frame([0.5, 0.1, 0.2, 1.0, -0.4, 0.5]))
    chart = Chart(loaded.model.robot(p), ("orientation", "position"))
    method = NetworkMethod(trained(chart, loaded.readings(400, seed=8)), chart)
    u = 0.7 * loaded.coordinates(8, seed=12)
    wanted = loaded.model.robot(p).measured(pose_at(loaded.chain, u))
    readings, reached = loaded.command(method, wanted)
    assert reached.all()
    got = method.predict(readings)
    np.testing.assert_allclose(got.rotation, wanted.rotation, atol=1e-9)
    np.testing.assert_allclose(got.translation, wanted.translation, atol=1e-9)


def test_a_network_says_what_it_does_not_reach(robot):
    """A desired pose far outside of all that the network puts out."""
    loaded = robot("ups3_s")
    chart = Chart(loaded.model.robot(loaded.random_parameters(7)), ("orientation",))
    method = NetworkMethod(trained(chart, loaded.readings(125, seed=8)), chart)
    inside, outside = np.zeros(6), np.array([0, 0, 0, np.deg2rad(130), 0, 0])
    wanted = chart.robot.measured(pose_at(loaded.chain, np.stack([inside, outside])))
    assert loaded.command(method, wanted)[1].tolist() == [True, False]


def assert_same(one: Motion, other: Motion) -> None:
    np.testing.assert_array_equal(one.rotation, other.rotation)
    np.testing.assert_array_equal(one.translation, other.translation)


@pytest.mark.parametrize("shrinkage, hull", [(0.0, 1.0), (1.0, -9.0)], ids=["no evidence", "outside of the hull"])
@pytest.mark.parametrize("name", ["ups3_s", "jugglebot"])
def test_where_nothing_is_believed_hybrid_is_geometric(robot, desired, correction, name, shrinkage, hull):
    """To the last bit, in predictions and in commands, whatever network and refined geometry say."""
    loaded = robot(name)
    p = loaded.random_parameters(7)
    method = hybrid(loaded, p, correction(loaded, 3e-3, shrinkage, hull))
    readings, wanted = loaded.readings(20, seed=3), desired(name, p)
    assert_same(method.geometric.predict(readings), method.predict(readings))
    commanded, reached = loaded.command(method, wanted)
    assert reached.all()
    np.testing.assert_allclose(commanded, loaded.command(method.geometric, wanted)[0], rtol=0, atol=1e-12)


def test_a_row_outside_is_geometric_among_others(robot, correction):
    """Bit for bit, though rows beside it are corrected; and each row is as if it were alone."""
    loaded = robot("ups3_s")
    method = hybrid(loaded, loaded.random_parameters(7), correction(loaded, 3e-3, 0.8, 0.5))
    readings = loaded.readings(60, seed=3)
    outside = method.correction.share(readings) == 0
    assert 5 < outside.sum() < 55
    whole, geometric = method.predict(readings), method.geometric.predict(readings)
    np.testing.assert_array_equal(whole.rotation[outside], geometric.rotation[outside])
    assert np.all(np.abs(whole.rotation - geometric.rotation).max(axis=(1, 2))[~outside] > 0)
    for row in (0, 1, 2):
        alone = method.predict(readings[[row]])
        np.testing.assert_allclose(alone.rotation[0], whole.rotation[row], rtol=0, atol=1e-14)


def test_the_correction_acts_on_the_joints(robot, correction):
    """Against the definition: W * forward(q + delta(q)) * T of the refined robot, delta in the joints' unit."""
    overrides = tuple(f"actuator.leg{k}_slide.{key}" for k in (1, 2, 3) for key in ("gain=0.001", "zero=0.2"))
    loaded = robot("ups3_s", overrides)
    readings = loaded.readings(10, seed=3)
    assert readings.min() > 50  # millimetres
    method = hybrid(loaded, loaded.random_parameters(7), correction(loaded, 1e-3))
    inside = method.correction.share(readings) == 1
    assert inside.sum() >= 5
    built, delta = method.refined, method.correction(readings)
    joints = built.actuators.zero + built.actuators.gain * readings + delta
    expected = built.instrument @ forward(built.chain, joints).pose @ built.target
    got = method.predict(readings)
    np.testing.assert_allclose(got.rotation[inside], expected.rotation[inside], atol=1e-13)
    np.testing.assert_allclose(got.translation[inside], expected.translation[inside], atol=1e-13)
    assert 1e-6 < np.abs(delta).max() < 1e-3  # metres


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_share_is_a_part_of_the_way(robot, correction, share):
    """Translations by their mean with weights; rotations against scipy's Slerp."""
    loaded = robot("jugglebot")
    whole = hybrid(loaded, loaded.random_parameters(7), correction(loaded, 3e-3, 1.0, 9.0))
    part = replace(whole, correction=replace(whole.correction, shrinkage=share))
    readings = loaded.readings(6, seed=3)
    start, end, between = (m.predict(readings) for m in (whole.geometric, whole, part))
    expected = (1 - share) * start.translation + share * end.translation
    np.testing.assert_allclose(between.translation, expected, rtol=0, atol=1e-13)
    for k in range(len(readings)):
        slerp = Slerp([0, 1], Rotation.from_matrix(np.stack([start.rotation[k], end.rotation[k]])))
        np.testing.assert_allclose(between.rotation[k], slerp(share).as_matrix(), atol=1e-12)
        assert np.linalg.norm(log(start.rotation[k].T @ end.rotation[k])) > 1e-5


@pytest.mark.parametrize("millimetres", [False, True])
def test_the_command_is_the_fixed_point(robot, correction, millimetres):
    """q + delta(q) = q*, with q* from the refined robot's inverse kinematics alone."""
    overrides = tuple(f"actuator.leg{k}_slide.gain=0.001" for k in (1, 2, 3)) if millimetres else ()
    loaded = robot("ups3_s", overrides)
    method = hybrid(loaded, loaded.random_parameters(7), correction(loaded, 1e-3, 1.0, 9.0))
    built = method.refined
    tool = pose_at(built.chain, 0.9 * loaded.coordinates(20, seed=13))
    closure = inverse(built.chain, tool_coordinates(built.chain, tool))
    wanted = closure.q[:, built.chain.actuated]
    readings, reached = loaded.command(method, built.measured(closure.pose))
    assert reached.all()
    delta = method.correction(readings)
    np.testing.assert_allclose(built.actuators.joints(readings) + delta, wanted, rtol=0, atol=1e-11)
    assert np.abs(delta).max() > 1e-5


def test_all_six_by_name_in_the_tables_order(robot, correction):
    """Each name against the parameters and the network that belong to it."""
    loaded = robot("ups3_s")
    n = len(loaded.model.parameters)
    registered, identified, refined = np.zeros(n), loaded.random_parameters(7), loaded.random_parameters(9)
    chart = Chart(loaded.model.robot(registered), ("orientation",))
    start = new_network(
        loaded.readings(20, seed=1), chart.of_tool(pose_at(loaded.chain, loaded.coordinates(20, 1))), 4, 0
    )
    one, two, three = (start.with_weights(k * start.weights) for k in (0.2, 0.3, 0.4))
    found = build(
        loaded.model,
        Fit(np.zeros(0, dtype=int), registered, identified),
        Learned(one, two, three, np.zeros((1, 6))),
        Corrected(refined, correction(loaded, 1e-3, 1.0, 9.0), np.zeros((0, 3))),
        ("orientation",),
    )
    assert tuple(found) == METHODS
    readings = loaded.readings(5, seed=2)
    for name, network, p in (
        ("network", one, registered),
        ("transfer", two, registered),
        ("transfer_identified", three, identified),
    ):
        expected = Chart(loaded.model.robot(p), ("orientation",)).pose(network(readings), readings)
        np.testing.assert_array_equal(found[name].predict(readings).rotation, expected.rotation)
    for name, p in (("nominal", registered), ("geometric", identified)):
        np.testing.assert_array_equal(found[name].predict(readings).rotation, loaded.poses(p, readings).rotation)
    shifted = loaded.model.robot(refined)
    joints = shifted.actuators.joints(readings) + found["hybrid"].correction(readings)
    expected = shifted.measured(forward(shifted.chain, joints).pose)
    np.testing.assert_allclose(found["hybrid"].predict(readings).rotation, expected.rotation, rtol=0, atol=1e-13)


def test_without_networks_or_a_correction_these_rows_are_missing(robot):
    loaded = robot("ups3_s")
    fit = Fit(np.zeros(0, dtype=int), *2 * [loaded.random_parameters(7)])
    assert tuple(build(loaded.model, fit, None, None, ("orientation",))) == ("nominal", "geometric")


# Refusals


def command(loaded, angles_deg, max_condition: float = 100.0, correction=None) -> np.ndarray:
    """Commands for orientations (n, 3) about home by the nominal model, poses numbered 10, 20, .."""
    u = np.zeros((len(angles_deg), 6))
    u[:, 3:] = np.deg2rad(angles_deg)
    model = loaded.model
    robot = model.robot(np.zeros(len(model.parameters)))
    method = ModelMethod(robot)
    if correction is not None:
        method = HybridMethod(method, robot, correction)
    workspace = loaded.description.workspace.model_copy(update={"max_condition": max_condition})
    numbers = 10 * np.arange(1, len(u) + 1)
    solver = Solvers(workspace).of(method, WHOLE)
    found = commands(solver, pose_at(loaded.chain, u), loaded.chain, model.actuators, workspace, numbers)
    found.check()
    return found.readings


def refused(loaded, pose_deg, *said: str, **options) -> None:
    """The second of three poses is refused, by its number, in one line."""
    with pytest.raises(InputError) as error:
        command(loaded, [(0, 0, 0), pose_deg, (1, 2, 3)], **options)
    assert str(error.value).startswith("pose 20")
    assert "\n" not in str(error.value)
    for text in said:
        assert text in str(error.value)


def test_leg_lengths_are_commanded(robot):
    """Against the closed form of the paper's eq. 2: distances of the joints on base and platform."""
    loaded = robot("ups3_s")
    angles = [(0, 0, 0), (10, -15, 5), (-20, 20, -10)]
    lengths = command(loaded, angles)
    u = np.zeros((3, 6))
    u[:, 3:] = np.deg2rad(angles)
    rotation, h = pose_at(loaded.chain, u).rotation, 0.45
    for k in range(3):
        at, to = 2 * np.pi * k / 3, 2 * np.pi * k / 3 + np.pi / 4
        base = 0.30 * np.array([np.cos(at), np.sin(at), 0.0])
        platform = 0.20 * np.array([np.cos(to), np.sin(to), 0.0])
        expected = np.linalg.norm(np.array([0, 0, h]) + rotation @ platform - base, axis=1)
        np.testing.assert_allclose(lengths[:, k], expected, atol=1e-9)


def test_a_pose_that_cannot_be_reached_is_refused(robot):
    """Behind the singularity at -45 degrees of yaw: with the same leg lengths home's branch is at -30 degrees."""
    refused(robot("ups3_s"), (0, 0, -60), "can't be reached")
    refused(robot("ups3_s"), (170, 0, 0))  # upside down the legs' lengths are legal, but belong to another pose


@pytest.mark.parametrize("corrected", [False, True])
def test_a_pose_beyond_a_joint_limit_is_refused(robot, correction, corrected):
    """Slides end at 0.35 and 0.65 m; at 60 degrees of tilt one leg is shorter."""
    own = correction(robot("ups3_s"), 1e-4, hull=9.0) if corrected else None
    refused(robot("ups3_s"), (0, 60, 0), "_slide", "limits are [0.35, 0.65]", correction=own)


def test_a_passive_joint_beyond_its_limit_is_refused(robot, edited):
    """A centre joint that may turn to 0.3 rad about its first axis, commanded to 0.35 (20 degrees)."""
    place = '<origin xyz="0 0 0.45"/>\n    <axis xyz="1 0 0"/>\n    <limit lower="-1.4" upper='
    loaded = robot(str(edited(urdf=[(f'{place}"1.4"', f'{place}"0.3"')])))
    command(loaded, [(17, 0, 0)])
    refused(loaded, (20, 0, 0), "'centre_x'", "0.3")


def test_a_pose_near_a_singularity_is_refused(robot):
    """At -45 degrees of yaw base and platform joints align (the printed geometry): the legs have no moment about z."""
    refused(robot("ups3_s"), (0, 0, -44), "singular", "max_condition = 50", max_condition=50.0)
    refused(robot("ups3_s"), (0, 0, -44.9))
