"""MJCF: the same robots as by URDF, MuJoCo's conventions, and what is refused."""

from __future__ import annotations

import contextlib
from itertools import permutations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.urdf.closed_chain import load_chain, load_drawing
from kincal.urdf.description import Loop, Mechanism, Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import at_home, forward, inverse, loop_error, loop_jacobian, passive_rates, tool_pose, tree
from kincal.urdf.workspace import check_workspace, mobility

PAIRS = (("ups3_mjcf", "ups3_s"), ("ups3_frame_mjcf", "ups3_frame"))
DATA = Path(__file__).parents[1] / "data"
UPS3 = (DATA / "ups3_mjcf" / "robot.xml").read_text()
FILE = Path("robot.xml")
MECHANISM = Mechanism(
    base_frame="world",
    tool_frame="platform",
    actuated=("leg1_slide", "leg2_slide", "leg3_slide"),
    workspace=Workspace(rotation_deg={"x": (-20, 20), "y": (-20, 20), "z": (-10, 10)}),
)
numbers = st.floats(-3, 3)


def wrapped(worldbody: str, rest: str = "") -> str:
    return f"<mujoco>{rest}<worldbody>{worldbody}</worldbody></mujoco>"


def frames(text: str, q=()) -> dict[str, pin.SE3]:
    """Every body's and site's placement in the world."""
    model = load_drawing(text, FILE).model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q, dtype=float) if len(q) else np.zeros(model.nq))
    return {f.name: data.oMf[i] for i, f in enumerate(model.frames) if f.type != pin.FrameType.JOINT}


def chain_of(text: str, mechanism: Mechanism = MECHANISM):
    return at_home(load_chain(mechanism, text, FILE), None)


def same_pose(found, expected, atol=1e-12) -> None:
    np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=atol)
    np.testing.assert_allclose(found.translation, expected.translation, rtol=0, atol=atol)


# The same robots as by URDF


@pytest.mark.parametrize("mjcf, urdf", PAIRS)
def test_kinematics_are_those_of_the_urdf(mjcf, urdf, robot):
    """Poses, all joint values, loop errors, loop Jacobians and passive rates, in the order of the URDF's joints."""
    ours, theirs = robot(mjcf), robot(urdf)
    order = [ours.chain.joint_names.index(name) for name in theirs.chain.joint_names]
    assert sorted(order) == list(range(theirs.chain.n_joints))
    np.testing.assert_allclose(ours.chain.home[order], theirs.chain.home, rtol=0, atol=1e-12)
    u = theirs.coordinates(40, 3)
    expected, found = inverse(theirs.chain, u), inverse(ours.chain, u)
    assert found.closed.all()
    np.testing.assert_allclose(found.q[:, order], expected.q, rtol=0, atol=3e-12)
    reached = forward(ours.chain, expected.q[:, theirs.chain.actuated])
    np.testing.assert_allclose(reached.q[:, order], expected.q, rtol=0, atol=3e-12)
    same_pose(reached.pose, expected.pose, 3e-12)
    open_q = expected.q + 0.1 * np.random.default_rng(4).normal(size=expected.q.shape)
    unsorted = np.empty_like(open_q)
    unsorted[:, order] = open_q
    for q, own in ((expected.q, found.q), (open_q, unsorted)):
        at, own_at = tree(theirs.chain, q), tree(ours.chain, own)
        same_pose(tool_pose(ours.chain, own_at), tool_pose(theirs.chain, at), 3e-12)
        jacobian = loop_jacobian(ours.chain, own_at)[:, :, order]
        np.testing.assert_allclose(loop_error(ours.chain, own_at), loop_error(theirs.chain, at), rtol=0, atol=3e-12)
        np.testing.assert_allclose(jacobian, loop_jacobian(theirs.chain, at), rtol=0, atol=3e-12)
    rates = passive_rates(ours.chain, found.q)[:, order]
    np.testing.assert_allclose(rates, passive_rates(theirs.chain, expected.q), rtol=0, atol=1e-10)


@pytest.mark.parametrize("mjcf, urdf", PAIRS)
def test_the_model_stages_checks_find_the_same(mjcf, urdf, robot, checked):
    ours, theirs = (checked(DATA / name if (DATA / name).is_dir() else name) for name in (mjcf, urdf))
    assert (ours.mobility, ours.n_checked) == (theirs.mobility, theirs.n_checked) == (3, 1331)
    assert ours.worst_condition == pytest.approx(theirs.worst_condition, rel=1e-9)
    own, urdf_limits = ({n: (c.lower[k], c.upper[k]) for k, n in enumerate(c.joint_names)}
                        for c in (robot(mjcf).chain, robot(urdf).chain))  # fmt: skip
    for name, limits in urdf_limits.items():
        assert own[name] == pytest.approx(limits, abs=1e-12)


def test_parameters_are_named_by_the_frames_that_meet(robot):
    """Of the unnamed loop too; a site's or a body's name after the loop's."""
    chain = robot("ups3_mjcf").chain
    assert [loop.name for loop in chain.loops] == ["leg1", "leg2", "connect1"]
    assert chain.body_names[12:] == ("leg1.leg1_tip", "leg1.platform_joint1", "leg2.leg2_rod", "leg2.platform",
                                     "connect1.leg3_tip", "connect1.platform_joint3")  # fmt: skip
    names = robot("ups3_mjcf").model.parameters.names
    assert len(set(names)) == len(names)
    assert {"leg2.platform.x", "centre_y.rz", "connect1.leg3_tip.z"} <= set(names)
    assert load_drawing(UPS3, FILE).driven == ("leg1_slide", "leg2_slide", "leg3_slide")


def test_a_floating_platform_on_a_ball_is_a_platform_on_a_ball(robot):
    """Three slides and three hinges with a `connect` to the world: three joints and three equations more."""
    text = UPS3.replace('<joint name="centre" type="ball" range="0 1.4"/>', '<freejoint name="centre"/>')
    text = text.replace("</equality>", '<connect name="centre" body1="platform" anchor="0 0 0"/></equality>')
    floating, ball = chain_of(text), robot("ups3_mjcf").chain
    assert floating.n_joints == ball.n_joints + 3
    assert {f"centre_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")} <= set(floating.joint_names)
    assert floating.loops[-1].frames == ("platform", "world")
    assert mobility(floating) == 3
    actuated = robot("ups3_mjcf").configurations(10, 5)[:, ball.actuated]
    same_pose(forward(floating, actuated).pose, forward(ball, actuated).pose, 1e-11)


def test_loops_of_robot_toml_come_after_those_of_the_file(robot):
    text = UPS3.replace('<connect site1="leg3_tip" site2="platform_joint3"/>', "")
    loop = Loop(name="third", kind="point", frames=("leg3_tip", "platform_joint3"))
    chain = chain_of(text, MECHANISM.model_copy(update={"loop": (loop,)}))
    assert [loop.name for loop in chain.loops] == ["leg1", "leg2", "third"]
    expected = robot("ups3_mjcf").chain
    u = robot("ups3_mjcf").coordinates(5, 1)
    np.testing.assert_allclose(inverse(chain, u).q, inverse(expected, u).q, rtol=0, atol=1e-12)


@pytest.mark.parametrize("base", ["world", "universe"])
def test_the_world_is_a_base_frame(base, robot):
    chain = chain_of(UPS3, MECHANISM.model_copy(update={"base_frame": base}))
    np.testing.assert_allclose(chain.home, robot("ups3_mjcf").chain.home, rtol=0, atol=1e-12)
    assert check_workspace(chain, MECHANISM.workspace).mobility == 3


# MuJoCo's conventions


@given(values=st.lists(numbers, min_size=3, max_size=3), axes=st.sampled_from(list(permutations("xyz", 3))))
def test_euler_angles_are_about_moving_axes_and_in_upper_case_about_fixed_ones(values, axes):
    """scipy writes it the other way round."""
    sequence, text = "".join(axes), " ".join(map(repr, values))
    for own, theirs in ((sequence, sequence.upper()), (sequence.upper(), sequence)):
        settings = f'<compiler angle="radian" eulerseq="{own}"/>'
        found = frames(wrapped(f'<body name="b" euler="{text}"/>', settings))["b"]
        np.testing.assert_allclose(found.rotation, Rotation.from_euler(theirs, values).as_matrix(), rtol=0, atol=1e-14)
    degrees = frames(wrapped(f'<body name="b" euler="{text}"/>', f'<compiler eulerseq="{sequence}"/>'))["b"]
    expected = Rotation.from_euler(sequence.upper(), values, degrees=True).as_matrix()
    np.testing.assert_allclose(degrees.rotation, expected, rtol=0, atol=1e-14)


@given(vector=st.lists(numbers, min_size=3, max_size=3), angle=numbers)
def test_one_orientation_written_in_five_ways(vector, angle):
    axis = np.array(vector)
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    expected = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    x, y, z = expected.as_matrix().T
    quaternion = 2.5 * expected.as_quat(scalar_first=True)
    written = {
        "axisangle": [*axis, angle],
        "quat": quaternion,
        "xyaxes": [*(2 * x), *(y + 0.5 * x)],
        "euler": expected.as_euler("XYZ"),
    }
    for key, values in written.items():
        text = " ".join(repr(float(v)) for v in values)
        found = frames(wrapped(f'<body name="b" {key}="{text}"/>', '<compiler angle="radian"/>'))["b"]
        np.testing.assert_allclose(found.rotation, expected.as_matrix(), rtol=0, atol=1e-7 if key == "euler" else 1e-12)
    found = frames(wrapped(f'<body name="b" zaxis="{" ".join(repr(float(v)) for v in 3 * z)}"/>'))["b"].rotation
    np.testing.assert_allclose(found[:, 2], z, rtol=0, atol=1e-12)  # by the shortest turn: about an axis across z
    assert abs(Rotation.from_matrix(found).as_rotvec()[2]) < 1e-7


@given(values=st.lists(numbers, min_size=19, max_size=19))
def test_joints_of_a_body_follow_one_another_as_pinocchio_has_it(values, tmp_path_factory):
    """A universal joint with its axes apart, a slide and a ball, by Pinocchio's own reader of MJCF."""
    pos, axis = ("{:.6f} {:.6f} {:.6f}".format(*values[k : k + 3]) for k in (0, 3))
    if np.linalg.norm(values[3:6]) < 1e-3:
        axis = "0 1 0"
    body = f"""<body name="a" pos="1 2 3" euler="0.1 0.2 0.3"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
        <joint name="u1" axis="{axis}" pos="{pos}"/><joint name="u2" axis="0 1 0" pos="0 0.5 0"/>
        <body name="b" pos="{pos}" quat="1 2 0 0"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
          <joint name="s" type="slide" axis="{axis}"/><site name="end" pos="0 0 1" zaxis="1 0 1"/>
          <body name="c" pos="0 1 0"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
            <joint name="ball" type="ball" pos="0.1 0 0.2"/></body></body></body>"""
    text = wrapped(body, '<compiler angle="radian"/>').replace("<mujoco>", '<mujoco model="m">')
    file = tmp_path_factory.mktemp("mjcf") / "robot.xml"
    file.write_text(text)
    theirs = pin.buildModelFromMJCF(file)
    angles = values[9:12]
    q = np.concatenate([values[6:9], Rotation.from_euler("XYZ", angles).as_quat()])
    data = theirs.createData()
    pin.framesForwardKinematics(theirs, data, q)
    found = frames(text, [*values[6:9], *angles])
    for name in ("a", "b", "c", "end"):
        expected = data.oMf[theirs.getFrameId(name)]
        np.testing.assert_allclose(found[name].homogeneous, expected.homogeneous, rtol=0, atol=1e-12)


def test_defaults_frames_and_ref_are_mujocos():
    """The numbers are those of MuJoCo 4.0's own compiler and forward kinematics, rounded to four digits."""
    text = wrapped(
        """<site name="ws" pos="1 2 3"/>
        <body name="A" pos="0 0 1" euler="10 20 30">
          <joint name="ja"/>
          <body name="A2" pos="0.1 0 0" childclass="par">
            <joint name="u1" axis="1 0 0" pos="0 0 0.1"/><joint name="u2" axis="0 1 0" pos="0 0 0.2" class="kid"/>
            <site name="s2"/>
            <body name="A3" pos="0 0 0.3">
              <joint name="slide" class="sl" axis="0 0 1" ref="0.05"/>
              <site name="s3" pos="0 0 0.1" euler="90 0 0"/>
              <body name="A4" pos="0 0.2 0"><site name="s4" pos="0 0 0.1"/></body>
            </body>
          </body>
        </body>
        <frame pos="0 0 1" euler="0 90 0"><body name="B"><frame pos="0 1 0"><joint name="jb" axis="1 0 0"
          pos="0 0 0.5" ref="30" range="-10 10"/></frame></body></frame>""",
        """<compiler angle="degree" eulerseq="zyx"/>
        <default><joint type="hinge" axis="0 1 0"/>
          <default class="sl"><joint type="slide" range="0.1 0.4"/></default>
          <default class="par"><joint axis="1 0 0"/><site pos="0 0 0.5"/>
            <default class="kid"><joint range="-30 30"/></default></default></default>""",
    )
    drawing = load_drawing(text, FILE)
    assert list(drawing.model.names)[1:] == ["ja", "u1", "u2", "slide", "jb"]
    np.testing.assert_allclose(drawing.configuration, [0, 0, 0, 0.05, np.pi / 6])
    np.testing.assert_allclose(drawing.model.lowerPositionLimit, [-np.inf, -np.inf, -np.pi / 6, 0.1, -np.pi / 18])
    found = frames(text, drawing.configuration)
    expected = {"ws": [1, 2, 3], "A3": [0.2061, -0.1160, 1.2099], "s2": [0.2818, -0.2042, 1.3727],
                "s3": [0.2440, -0.1601, 1.2913], "s4": [0.2476, 0.0164, 1.3853], "B": [0, 0, 1]}  # fmt: skip
    for name, position in expected.items():
        np.testing.assert_allclose(found[name].translation, position, atol=6e-5)
    out = frames(text, [0, 0, 0, 0.25, np.pi / 6])["A3"].translation - found["A3"].translation
    np.testing.assert_allclose(np.linalg.norm(out), 0.2)


def test_a_weld_as_drawn_holds_what_it_shows():
    """Also where the anchor lies off the body and both bodies are turned."""
    weld = '<equality><weld body1="a" body2="b" anchor="0.3 0 0.1"/></equality>'
    bodies = (
        '<body name="a" pos="1 0 0" euler="0 40 0"><joint ref="7"/></body><body name="b" euler="10 0 5"><joint/></body>'
    )
    loop = load_drawing(wrapped(bodies, weld), FILE).loops[0]
    at = frames(wrapped(bodies), [np.deg2rad(7), 0])
    ends = [at[name] * pin.SE3(m.rotation, m.translation) for name, m in zip("ab", loop.placements, strict=True)]
    np.testing.assert_allclose(ends[0].homogeneous, ends[1].homogeneous, rtol=0, atol=1e-14)
    assert (loop.kind, loop.frames, loop.name) == ("frame", ("a", "b"), "weld1")
    np.testing.assert_allclose(loop.placements[1].translation, [0.3, 0, 0.1])


def test_names_for_what_has_none():
    text = wrapped(
        '<body><joint/><joint axis="1 0 0"/></body><body name="body2"><freejoint/></body><body><joint/></body>'
    )
    model = load_drawing(text, FILE).model
    assert list(model.names)[1:5] == ["body1_joint", "body1_joint2", "body2_free_x", "body2_free_y"]
    assert model.names[-1] == "body3_joint"


# What is refused

BODY = '<body name="a" pos="0 0 1"><joint name="j"/></body><body name="b"><joint name="k"/></body>'


def closing(equality: str, rest: str = "") -> str:
    return wrapped(BODY, f"<equality>{equality}</equality>{rest}")


REFUSALS = {
    "no worldbody": ("<mujoco/>", ["worldbody"]),
    "a URDF in its clothes": ('<mujoco><link name="base"/></mujoco>', ["worldbody"]),
    "entities": ('<!DOCTYPE m [<!ENTITY a "aa">]><mujoco><worldbody/></mujoco>', ["not allowed"]),
    "malformed": ("<mujoco><worldbody></mujoco>", ["not well-formed"]),
    "an include": ('<mujoco><include file="/etc/passwd"/><worldbody/></mujoco>', ["<include>"]),
    "an include in a body": (wrapped('<body><include file="x.xml"/></body>'), ["<include>"]),
    "copies": (wrapped('<replicate count="3"><body/></replicate>'), ["<replicate>"]),
    "an attached model": (wrapped('<attach model="m" body="b"/>'), ["<attach>"]),
    "a joint coupling": (closing('<joint name="gears" joint1="j" joint2="k"/>'), ["gears", "<joint>", "<weld>"]),
    "a tendon coupling": (closing('<tendon tendon1="t"/>'), ["tendon1", "<tendon>", "<connect>"]),
    "an inactive loop": (
        closing('<connect name="c" body1="a" body2="b" anchor="0 0 0" active="false"/>'),
        ["'c'", "not active"],
    ),
    "loops inactive by default": (
        closing('<weld body1="a" body2="b"/>', '<default><equality active="false"/></default>'),
        ["'weld1'", "not active"],
    ),
    "a body that does not exist": (closing('<connect body1="a" body2="bb" anchor="0 0 0"/>'), ["'bb'", "mean 'b'"]),
    "a site that does not exist": (closing('<weld site1="a" site2="b"/>'), ["site 'a'"]),
    "sites and bodies": (closing('<weld site1="a" body2="b"/>'), ["either body1", "site1"]),
    "no anchor": (closing('<connect body1="a" body2="b"/>'), ["connect1", "anchor"]),
    "a weld that turns": (closing('<weld body1="a" torquescale="0"/>'), ["weld1", "torquescale", "<connect>"]),
    "two loops of one name": (closing(2 * '<weld name="w" body1="a"/>'), ["'w'", "differ"]),
    "two joints of one name": (wrapped(BODY.replace('"k"', '"j"')), ["two joints", "'j'"]),
    "a ball with a joint's name": (
        wrapped('<body><joint name="j" type="ball"/></body><body><joint name="j_x"/></body>'),
        ["two joints", "'j_x'"],
    ),
    "two bodies of one name": (wrapped(BODY.replace('"b"', '"a"')), ["two bodies", "'a'"]),
    "two sites of one name": (wrapped(2 * '<site name="s"/>'), ["two sites", "'s'"]),
    "a body moved by hand": (wrapped('<body name="m" mocap="true"/>'), ["'m'", "mocap"]),
    "an unknown joint type": (wrapped('<body><joint name="j" type="screw"/></body>'), ["'j'", "'screw'", "ball"]),
    "an unknown element": (wrapped('<body name="b"><jiont/></body>'), ["'b'", "<jiont>", "mean 'joint'"]),
    "a joint of the world": (wrapped("<joint/>"), ["worldbody", "joint"]),
    "a free joint with another": (wrapped('<body name="b"><freejoint/><joint/></body>'), ["'b'", "free"]),
    "a free joint on a joint": (wrapped("<body><joint/><body><freejoint/></body></body>"), ["free"]),
    "an axis of length zero": (wrapped('<body><joint name="j" axis="0 0 0"/></body>'), ["'j'", "axis"]),
    "an axis of two numbers": (wrapped('<body><joint name="j" axis="0 1"/></body>'), ["'j'", "axis", "3 finite"]),
    "words for numbers": (wrapped('<body name="b" pos="0 0 up"/>'), ["'b'", "pos", "up"]),
    "no number": (wrapped('<body name="b" pos="0 0 nan"/>'), ["'b'", "pos", "finite"]),
    "a quaternion of zeros": (wrapped('<body name="b" quat="0 0 0 0"/>'), ["'b'", "quat"]),
    "two orientations": (wrapped('<body name="b" quat="1 0 0 0" euler="0 0 0"/>'), ["'b'", "quat", "euler"]),
    "a range reversed": (wrapped('<body><joint name="j" range="3 2"/></body>'), ["'j'", "range", "lower"]),
    "a ball's range from below": (wrapped('<body><joint name="j" type="ball" range="-3 2"/></body>'), ["'j'", "range"]),
    "a range that may count or not": (
        wrapped('<body><joint name="j" range="1 2"/></body>', '<compiler autolimits="false"/>'),
        ["'j'", "limited"],
    ),
    "global coordinates": (wrapped("", '<compiler coordinate="global"/>'), ["coordinate", "global"]),
    "another unit": (wrapped("", '<compiler angle="grad"/>'), ["angle", "'grad'", "degree, radian"]),
    "an Euler sequence": (wrapped("", '<compiler eulerseq="xyw"/>'), ["eulerseq", "xyw"]),
    "an unknown class": (wrapped('<body><joint class="leg"/></body>'), ["class 'leg'"]),
    "a class without name": (wrapped("", "<default><default/></default>"), ["default", "name"]),
    "a class twice": (wrapped("", '<default><default class="c"/><default class="c"/></default>'), ["'c'"]),
    "too many joints": (wrapped("<body><joint/></body>" * 501), ["501 joints", "500"]),
    "too many bodies": (wrapped("<body>" * 3000 + "</body>" * 3000), ["3000", "2000"]),
}  # fmt: skip


@pytest.mark.parametrize("text, named", REFUSALS.values(), ids=REFUSALS)
def test_mjcf_is_refused(text, named):
    with pytest.raises(InputError) as refusal:
        load_drawing(text, FILE)
    message = str(refusal.value)
    assert message.startswith("robot.xml: ")
    assert "\n" not in message
    for words in named:
        assert words in message.removeprefix("robot.xml"), f"{words!r} is not in {message!r}"


def test_nothing_else_is_opened(monkeypatch):
    """Meshes, textures and height fields are neither needed nor looked for."""
    assets = '<asset><mesh file="/etc/passwd"/><texture file="x.png"/><hfield name="h" file="y.png"/></asset>'
    text = UPS3.replace("<worldbody>", assets + "<worldbody>")
    monkeypatch.setattr("builtins.open", lambda *_: pytest.fail("a file was opened"))
    assert load_drawing(text, FILE).model.njoints == 13


@pytest.mark.parametrize(
    "toml, words",
    [
        ({"loop": (Loop(name="leg1", kind="point", frames=("leg3_tip", "world")),)}, r"loop 'leg1': robot\.xml closes"),
        ({"tool_frame": "leg1_rood"}, r"tool_frame.*'leg1_rood'.*mean 'leg1_rod'"),
        ({"base_frame": "platform"}, r"base_frame: 'platform' moves with joint 'centre_z'"),
        ({"actuated": ("centre",)}, r"actuated: joint 'centre' is not among.*mean 'centre_"),
    ],
)  # fmt: skip
def test_a_mechanism_that_does_not_fit_is_refused(toml, words):
    with pytest.raises(InputError, match=words):
        load_chain(MECHANISM.model_copy(update=toml), UPS3, FILE)


def test_a_frame_that_two_things_are_called_is_refused():
    """MuJoCo keeps the names of bodies and of sites apart."""
    text = UPS3.replace('<site name="leg1_tip"/>', '<site name="leg1_tip"/><site name="platform"/>')
    with pytest.raises(InputError, match=r"tool_frame: robot\.xml has 2 frames called 'platform'"):
        load_chain(MECHANISM, text, FILE)


def test_a_loop_on_one_body_closes_nothing():
    text = UPS3.replace('site2="platform_joint1"', 'site2="leg1_tip2"')
    text = text.replace('<site name="leg1_tip"/>', '<site name="leg1_tip"/><site name="leg1_tip2"/>')
    with pytest.raises(InputError, match="loop 'leg1': both frames sit on one body"):
        load_chain(MECHANISM, text, FILE)


@given(cut=st.integers(0, len(UPS3)), junk=st.text(max_size=8))
def test_a_spoiled_file_is_read_or_refused(cut, junk):
    """Never another exception."""
    text = UPS3[:cut] + junk + UPS3[cut + len(junk) :]
    with contextlib.suppress(InputError):
        load_chain(MECHANISM, text, FILE)
