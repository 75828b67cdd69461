"""Commands for robots that can't have every pose, and for poses that were not measured altogether."""

import io
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kincal.identification.accuracy import gravity_error
from kincal.identification.channels import parts
from kincal.identification.measurements import to_measurements
from kincal.learning.transfer import new_network, train
from kincal.pipeline.compensator.commands import attempt
from kincal.pipeline.compensator.goal import Goal
from kincal.pipeline.compensator.network_solver import NetworkSolver
from kincal.pipeline.compensator.solvers import Solvers
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod, NetworkMethod
from kincal.pipeline.virtual.robot import VirtualRobot, draw
from kincal.urdf.description import VirtualErrors
from kincal.urdf.kinematics import inverse, pose_at, tool_coordinates, tool_rates
from kincal.urdf.rigid_motion import Motion, exp

# robot, what is measured (and so desired)
KINDS = [
    ("rps3", ("orientation", "position")),
    ("rps3", ("tilt", "position")),
    ("linear_delta", ("position",)),
    ("linear_delta", ("orientation", "position")),
    ("ups2_u", ("tilt",)),
    ("ups2_u", ("orientation",)),
    ("ups2_u", ("yaw",)),
    ("ups3_s", ("tilt",)),
]
# W and T of any size: a tracker that stands anywhere, a target out on an arm; what measures tilt stands on end less
FRAMES = {
    False: ([0.5, 0.1, 0.2, 1.0, -0.4, 2.5], [0.05, -0.03, 0.12, 0.6, 1.0, -0.8]),
    True: ([0.5, 0.1, 0.2, 0.1, -0.2, 2.5], [0.05, -0.03, 0.12, 0.2, 0.1, -0.8]),
}


def ids(kind) -> str:
    return f"{kind[0]}-{'+'.join(kind[1])}"


def built(loaded, channels: tuple[str, ...], seed: int = 3):
    """A robot as built, three tolerances off."""
    instrument, target = (Motion.from_vector(np.array(v)) for v in FRAMES["tilt" in channels or "yaw" in channels])
    p = loaded.random_parameters(seed, tolerances=3.0, instrument=instrument, target=target)
    return loaded.model.robot(p)


def apart(desired: Motion, got: Motion, channels: tuple[str, ...]) -> float:
    """The largest error of what `channels` measure [m, rad]."""
    found = [0.0]
    if "orientation" in channels:
        found.append(np.abs(desired.rotation - got.rotation).max())
    if "tilt" in channels:
        found.append(np.abs(gravity_error(desired.rotation, got.rotation)).max())
    if "yaw" in channels:
        (a, b), (c, d) = (m.rotation[:, :2, 0].T for m in (desired, got))
        found.append(np.abs(np.arctan2(b * c - a * d, a * c + b * d)).max())
    if "position" in channels:
        found.append(np.abs(desired.translation - got.translation).max())
    return float(max(found))


def spoiled(pose: Motion, channels: tuple[str, ...], size: float = 0.3) -> Motion:
    """The same poses with all that `channels` don't measure changed at random."""
    random, n = np.random.default_rng(0), len(pose.translation)
    known, rotation, translation = parts(channels), pose.rotation, pose.translation
    turn = size * random.normal(size=(n, 3))
    if "tilt" not in known:
        turn = turn if "yaw" not in known else turn * 0
        rotation = rotation @ exp(turn)
    elif "yaw" not in known:
        rotation = exp(turn * [0, 0, 1]) @ rotation
    return Motion(rotation, translation if "position" in known else translation + size * random.normal(size=(n, 3)))


@pytest.mark.parametrize("kind", KINDS, ids=ids)
def test_rates_of_what_is_filled_in(robot, kind, central_difference):
    """Against central differences along the mechanism, where the goal is met: parasitic motion, and the filling."""
    loaded = robot(kind[0])
    known = built(loaded, kind[1])
    axes, n = list(loaded.chain.tool_axes), len(loaded.chain.tool_axes)
    at = 0.8 * loaded.coordinates(1, seed=1)[0, axes]
    here = inverse(known.chain, _full(at[None], axes))
    desired, goal = known.measured(here.pose), Goal(known, parts(kind[1]))

    def along(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose = inverse(known.chain, _full(x, axes)).pose
        everywhere = Motion(np.repeat(desired.rotation, len(x), 0), np.repeat(desired.translation, len(x), 0))
        tool = goal.tool(everywhere, known.measured(pose))
        return tool_coordinates(known.chain, pose), tool_coordinates(known.chain, tool)

    moved, filled = (central_difference(lambda x, k=k: along(x)[k], at) for k in (0, 1))
    np.testing.assert_allclose(tool_rates(known.chain, here.q)[0], moved, atol=1e-7)
    np.testing.assert_allclose(goal.rates(desired, here.q)[0], filled, atol=1e-7)
    assert moved.shape == (6, n)


def _full(values: np.ndarray, axes: list[int]) -> np.ndarray:
    u = np.zeros((len(values), 6))
    u[:, axes] = values
    return u


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ("ups2_u", ("yaw",))], ids=ids)
def test_what_was_measured_is_reached_whatever_the_rest_says(robot, kind):
    """With the true model, poses that the robot can have: parts that nobody measured are changed at will."""
    loaded, channels = robot(kind[0]), kind[1]
    known = built(loaded, channels)
    desired = known.measured(known.close(loaded.readings(40, seed=2)).pose)
    asked = spoiled(desired, channels, 0.02 if kind[0] == "ups3_s" else 2.0)  # which may turn about the vertical
    method = ModelMethod(known)
    readings, reached = loaded.command(method, asked, channels)
    assert reached.all()
    assert apart(desired, method.predict(readings), channels) < 1e-9
    if kind[0] != "ups3_s":
        np.testing.assert_allclose(readings, loaded.readings(40, seed=2), atol=1e-8)


@pytest.mark.parametrize("shrinkage", [1.0, 0.4])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ("ups2_u", ("yaw",))], ids=ids)
def test_hybrid_reaches_what_was_measured(robot, correction, kind, shrinkage):
    """The same of a robot with a correction, wholly or in part believed: its own predictions are met again."""
    loaded, channels = robot(kind[0]), kind[1]
    known = built(loaded, channels)
    part = correction(loaded, 1e-3, shrinkage, 0.9 if shrinkage < 1 else 9.0)
    method = HybridMethod(ModelMethod(built(loaded, channels, 4)), known, part)
    desired = method.predict(loaded.readings(20, seed=2))
    readings, reached = loaded.command(
        method, spoiled(desired, channels, 0.02 if kind[0] == "ups3_s" else 2.0), channels
    )
    assert reached.all()
    assert apart(desired, method.predict(readings), channels) < 1e-9


@pytest.mark.parametrize("name, channels", [KINDS[0], KINDS[2], KINDS[4]])
def test_the_closed_loop_of_a_virtual_robot(robot, name, channels):
    """Without hidden errors and with its own parameters known: where it should be, to a micrometre and -radian."""
    loaded = robot(name)
    truth = draw(loaded.model, VirtualErrors(elastic=False, screw=False), 4)
    virtual = VirtualRobot.of(loaded.model, truth)
    desired = virtual.pose(loaded.readings(100, seed=3))
    solvers = Solvers(loaded.description.workspace)
    tried = attempt(solvers.of(ModelMethod(virtual.robot), channels), desired, loaded.chain, loaded.model.actuators)
    assert tried.good(loaded.chain, loaded.description.workspace).all()
    assert apart(desired, virtual.pose(tried.readings), channels) < 1e-9
    nominal = ModelMethod(loaded.model.robot(np.concatenate([0 * truth.p[:-12], truth.p[-12:]])))
    tried = attempt(solvers.of(nominal, channels), desired, loaded.chain, loaded.model.actuators)
    assert apart(desired, virtual.pose(tried.readings), channels) > 1e-5


def test_of_a_pose_that_no_mechanism_has_the_tool_axes_are_met(robot):
    """3-RPS: x, y and rz at home, which the hinges don't allow; z, rx and ry of the tool are as desired."""
    loaded = robot("rps3")
    known = built(loaded, ("orientation", "position"))
    u = loaded.coordinates(30, seed=5)
    readings, reached = loaded.command(ModelMethod(known), known.measured(pose_at(known.chain, u)))
    assert reached.all()
    got = tool_coordinates(known.chain, known.close(readings).pose)
    np.testing.assert_allclose(got[:, 2:5], u[:, 2:5], atol=1e-10)
    assert np.abs(got[:, [0, 1, 5]]).max() > 1e-3


def test_an_orientation_that_is_not_the_tools_to_choose_is_ignored(robot):
    """Linear delta, everything measured, asked to be level: the target is where it should be, the platform tilted."""
    loaded, channels = robot("linear_delta"), ("orientation", "position")
    known = built(loaded, channels)
    desired = known.measured(known.close(loaded.readings(30, seed=6)).pose)
    level = replace(desired, rotation=desired.rotation @ exp(np.array([0.01, -0.02, 0.03])))
    method = ModelMethod(known)
    readings, reached = loaded.command(method, level, channels)
    assert reached.all()
    assert apart(desired, method.predict(readings), channels) < 1e-9


def trained(loaded, channels: tuple[str, ...]) -> tuple[NetworkMethod, np.ndarray]:
    """A network that has roughly learned where the robot goes, and the readings that it saw."""
    chart = Chart(built(loaded, channels), channels)
    readings = loaded.readings(125, seed=8)
    task = chart.of_tool(chart.robot.close(readings).pose)
    options = {"validation": 0.1, "iterations": 25, "seed": 0}
    start = new_network(readings, task, 8, seed=0)
    return NetworkMethod(train([start], readings, [task], [np.arange(len(readings))], **options)[0][0], chart), readings


@pytest.mark.parametrize(
    "name, measured, asked", [("ups2_u", ("orientation",), ("tilt",)), ("jugglebot", ("position",), ("position",))]
)
def test_newton_in_the_outputs_knows_how_its_goal_moves(robot, name, measured, asked, central_difference):
    """Derivatives of a network's error against central differences, as closely as the network is the model's."""
    method, readings = trained(robot(name), measured)
    at = 0.5 * readings[0] + 0.5 * readings.mean(axis=0)
    desired = method.predict(at[None])
    solver = Solvers(robot(name).description.workspace).of(method, asked)
    assert isinstance(solver, NetworkSolver)
    solver = replace(solver, model=replace(solver.model, goal=Goal(method.chart.robot, parts(asked))))

    def linearised(x: np.ndarray):
        everywhere = Motion(np.repeat(desired.rotation, len(x), 0), np.repeat(desired.translation, len(x), 0))
        q = method.chart.robot.close(x).q
        return solver.linearised(everywhere, x, q)

    axes = [0, 1] if name == "ups2_u" else [0, 1, 2]
    expected = central_difference(lambda x: linearised(x)[0], at)[axes]
    slope, unmoved = linearised(at[None])[1][0][axes], method.network.jacobian(at[None])[0][axes]
    assert np.abs(slope - expected).max() < 0.1 * np.abs(unmoved - expected).max()


@pytest.mark.parametrize(
    "name, measured, channels",
    [
        ("linear_delta", ("position",), ("position",)),
        ("linear_delta", ("orientation", "position"), ("position",)),
        ("linear_delta", ("tilt", "position"), ("position",)),
        ("jugglebot", ("position",), ("position",)),
        ("rps3", ("tilt", "position"), ("tilt", "position")),
        ("ups2_u", ("orientation",), ("tilt",)),
        ("ups2_u", ("tilt",), ("tilt",)),
    ],
)
def test_a_network_fills_in_its_own_prediction(robot, name, measured, channels):
    """What was measured and is desired, at the network's prediction; the rest of the desired poses is changed."""
    loaded = robot(name)
    method, readings = trained(loaded, measured)
    desired = method.predict(0.5 * readings[:20] + 0.5 * readings.mean(axis=0))
    size = 0.03 if name == "jugglebot" else 2.0  # which can turn as it is asked to
    commanded, reached = loaded.command(method, spoiled(desired, channels, size), channels)
    assert reached.all()
    got = method.predict(commanded)
    if name == "rps3":  # of the target's position height alone is the tool's to choose
        instrument = method.chart.robot.instrument
        desired, got = (replace(m, translation=(instrument.inverse() @ m).translation) for m in (desired, got))
        assert np.abs(desired.translation[:, 2] - got.translation[:, 2]).max() < 1e-8
        desired = replace(desired, translation=got.translation)
    assert apart(desired, got, channels) < 1e-8


# `kincal compensate`, with files that say no more than they must

QUICK = ("plan.poses=20", "pretrain.iterations=2", "pretrain.continued=1", "transfer.iterations=2")


@pytest.fixture
def compensated(cli, tmp_path):
    """compensated(robot, channels, columns, **desired): the table of commands, the rest of the poses as predicted."""

    def ask(robot: str, channels: list[str], desired: dict[str, np.ndarray]) -> pd.DataFrame:
        settings = (*QUICK, "measure.channels=[" + ", ".join(f'"{c}"' for c in channels) + "]")
        pd.DataFrame(desired).to_csv(tmp_path / "desired.csv", index=False)
        common = [a for s in settings for a in ("--set", s)]
        answer = cli("compensate", robot, "--poses", "desired.csv", "--method", "geometric", *common)
        assert answer.status == 0, answer.err
        (tmp_path / "joints.csv").write_text(answer.out)
        answer = cli("predict", robot, "--joints", "joints.csv", "--method", "geometric", *common)
        assert answer.status == 0, answer.err
        joints = pd.read_csv(tmp_path / "joints.csv")
        return joints.merge(pd.read_csv(io.StringIO(answer.out)), on="pose")

    return ask


def test_positions_alone_for_a_robot_that_only_translates(compensated):
    """Measured with its orientation; and a desired orientation, which it can't choose, changes nothing."""
    wanted = {"x": np.array([0.0, 0.05, -0.06]), "y": np.array([0.01, -0.07, 0.02]), "z": np.array([0.2, 0.25, 0.15])}
    found = compensated("linear_delta", ["orientation", "position"], wanted)
    for axis, values in wanted.items():
        np.testing.assert_allclose(found[axis], values, atol=1e-9)
    turned = dict(zip(("qx", "qy", "qz", "qw"), np.tile([[0.6], [0.0], [0.0], [0.8]], 3), strict=True))
    pd.testing.assert_frame_equal(compensated("linear_delta", ["orientation", "position"], wanted | turned), found)


def test_tilt_alone_for_a_robot_that_tilts(compensated):
    """Measured by an inclinometer; then by a tracker: its heading is the mechanism's to choose."""
    wanted = {"roll": np.deg2rad([0.0, 10.0, -12.0]), "pitch": np.deg2rad([1.0, -8.0, 11.0])}
    found = compensated("ups2_u", ["tilt"], wanted)
    for name, values in wanted.items():
        np.testing.assert_allclose(found[name], values, atol=1e-9)
    np.testing.assert_allclose(  # a heading, which no one has measured
        compensated("ups2_u", ["tilt"], wanted | {"yaw": np.array([1.0, 2.0, 3.0])})[["leg1_slide", "leg2_slide"]],
        found[["leg1_slide", "leg2_slide"]],
        atol=1e-9,
    )
    found = compensated("ups2_u", ["orientation"], wanted)
    r = to_measurements(found, (), None).as_poses().rotation  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(np.arctan2(r[:, 2, 1], r[:, 2, 2]), wanted["roll"], atol=1e-9)
    np.testing.assert_allclose(-np.arcsin(r[:, 2, 0]), wanted["pitch"], atol=1e-9)
