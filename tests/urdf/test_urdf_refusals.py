"""What a URDF or a mechanism must not be: one InputError each, and its message names the thing."""

from __future__ import annotations

import re

import pytest

from kincal.urdf.errors import InputError

CENTRE_Z = '<joint name="centre_z" type="revolute">'
LAST = "</robot>"


def joint(name: str, parent: str, child: str, extra: str = "", kind: str = "fixed") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{extra}</joint>'


URDF_REFUSALS = {
    "a link with two parents": (
        [(LAST, joint("closing", "leg1_tip", "platform_joint1") + LAST)],
        ["platform_joint1", "two parents", "platform", "leg1_tip", r"\[\[loop\]\]"],
    ),
    "a ring beside the tree": (
        [(LAST, '<link name="p"/><link name="q"/>' + joint("pq", "p", "q") + joint("qp", "q", "p") + LAST)],
        ["tree", "'[pq]'"],
    ),
    "a ring alone": (
        [(LAST, joint("back", "leg1_tip", "base") + LAST)],
        ["ring|ancestor|one root"],
    ),
    "two roots": ([(LAST, '<link name="island"/>' + LAST)], ["one root", "'base'", "'island'"]),
    "two joints of one name": (
        [(LAST, '<link name="x1"/>' + joint("centre_z", "platform", "x1") + LAST)],
        ["two joints", "'centre_z'"],
    ),
    "two links of one name": ([(LAST, '<link name="leg1_rod"/>' + LAST)], ["two links", "'leg1_rod'"]),
    "a link and a joint of one name": (
        [(LAST, '<link name="centre_z"/>' + joint("m", "platform", "centre_z") + LAST)],
        ["link and a joint", "'centre_z'"],
    ),
    "an unknown joint type": (
        [(CENTRE_Z, CENTRE_Z.replace("revolute", "spherical"))],
        ["centre_z", "spherical", "prismatic"],
    ),
    "a floating joint": ([(CENTRE_Z, CENTRE_Z.replace("revolute", "floating"))], ["centre_z", "floating"]),
    "a joint without type": ([(CENTRE_Z, '<joint name="centre_z">')], ["centre_z", "type", "revolute"]),
    "a joint without name": ([(CENTRE_Z, '<joint type="revolute">')], ["joint", "name"]),
    "a mimic joint": ([(CENTRE_Z, CENTRE_Z + '<mimic joint="centre_x"/>')], ["centre_z", "mimic"]),
    "a parent that does not exist": (
        [('<parent link="centre_ball2"/>', '<parent link="centre_bal2"/>')],
        ["centre_z", "centre_bal2", "did you mean 'centre_ball2'"],
    ),
    "entities": (
        [('<?xml version="1.0"?>', '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>')],
        ["not allowed"],
    ),
    "an external entity": (
        [('<?xml version="1.0"?>', '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>')],
        ["not allowed"],
    ),
    "a document type": ([('<?xml version="1.0"?>', '<?xml version="1.0"?><!DOCTYPE robot>')], ["not allowed"]),
    "malformed XML": ([(LAST, "")], ["not well-formed"]),
    "another root element": (
        [('<robot name="ups3_s">', "<sdf>"), (LAST, "</sdf>")],
        ["<sdf>", "<robot>", "<mujoco>"],
    ),
    "an axis of length zero": ([('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>')], ["leg1_slide", "axis"]),
    "an axis of two numbers": ([('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>')], ["leg1_slide", "axis"]),
    "an origin that is no number": ([('xyz="0 0 0.45"', 'xyz="0 0 nan"')], ["centre_x", "origin", "nan", "finite"]),
    "an infinite origin": ([('xyz="0 0 0.45"', 'xyz="0 0 inf"')], ["centre_x", "origin", "inf", "finite"]),
    "an origin in words": ([('xyz="0 0 0.45"', 'xyz="0 0 high"')], ["centre_x", "origin", "high"]),
    "a limit in words": ([('lower="0.35"', 'lower="short"')], ["leg1_slide", "limit", "short"]),
}  # fmt: skip


@pytest.mark.parametrize("changes, named", URDF_REFUSALS.values(), ids=URDF_REFUSALS)
def test_urdf_is_refused(changes, named, edited, checked):
    robot = edited(urdf=changes)
    with pytest.raises(InputError) as refusal:
        checked(robot)
    message = str(refusal.value)
    assert "robot.urdf" in message
    assert "\n" not in message
    for words in named:
        assert re.search(words, message), f"{words!r} is not in {message!r}"


MECHANISM_REFUSALS = {
    "a tool frame that does not exist": (
        [('tool_frame = "platform"', 'tool_frame = "platfrom"')],
        ["tool_frame", "platfrom", "did you mean 'platform'"],
    ),
    "a base frame that does not exist": (
        [('base_frame = "base"', 'base_frame = "bsae"')],
        ["base_frame", "bsae", "did you mean 'base'"],
    ),
    "a base frame that moves": (
        [('base_frame = "base"', 'base_frame = "leg1_rod"')],
        ["base_frame", "leg1_rod", "leg1_slide"],
    ),
    "a loop's frame that does not exist": (
        [('"leg2_tip", "platform_joint2"', '"leg2_tpi", "platform_joint2"')],
        ["loop 'leg2'", "leg2_tpi", "did you mean 'leg2_tip'"],
    ),
    "a joint's name for a frame": (
        [('"leg2_tip", "platform_joint2"', '"leg2_slide", "platform_joint2"')],
        ["loop 'leg2'", "leg2_slide"],
    ),
    "a loop of one frame": (
        [('"leg2_tip", "platform_joint2"', '"leg2_tip", "leg2_tip"')],
        ["loop 'leg2'", "leg2_tip"],
    ),
    "a loop on one body": (
        [('"leg2_tip", "platform_joint2"', '"leg2_tip", "leg2_rod"')],
        ["loop 'leg2'", "one body"],
    ),
    "an actuated joint that does not exist": (
        [('"leg3_slide"]', '"leg3_slid"]')],
        ["actuated", "leg3_slid", "did you mean 'leg3_slide'"],
    ),
    "a fixed joint as actuator": ([('"leg3_slide"]', '"leg3_tip_mount"]')], ["actuated", "leg3_tip_mount"]),
    "too few actuators": (
        [(', "leg3_slide"]', "]")],
        ["mobility", "3 degrees of freedom", "2 actuated joints"],
    ),
    "too few axes": (
        [(", z = [-10, 10] }", " }")],
        ["mobility", "3 degrees of freedom", "2 axes"],
    ),
    "too many axes": (
        [("[workspace]", "[workspace]\ntranslation_mm = { x = [-1, 1] }")],
        ["mobility", "3 degrees of freedom", "4 axes"],
    ),
    "a loop too few": (
        [('[[loop]]\nname = "leg3"\nkind = "point"\nframes = ["leg3_tip", "platform_joint3"]\n', "")],
        ["mobility", "6 degrees of freedom", "3 actuated joints"],
    ),
    "over-constrained loops": (
        [('name = "leg3"\nkind = "point"', 'name = "leg3"\nkind = "frame"')],
        ["over-constrained|can't be closed"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("changes, named", MECHANISM_REFUSALS.values(), ids=MECHANISM_REFUSALS)
def test_mechanism_is_refused(changes, named, edited, checked):
    robot = edited(toml=changes)
    with pytest.raises(InputError) as refusal:
        checked(robot)
    for words in named:
        assert re.search(words, str(refusal.value)), f"{words!r} is not in {refusal.value}"


def test_a_repeated_loop_is_over_constrained(edited, checked):
    """A loop closed twice adds three equations and no constraint."""
    again = '[[loop]]\nname = "again"\nkind = "point"\nframes = ["leg1_tip", "platform_joint1"]\n\n[workspace]'
    with pytest.raises(InputError, match=r"loops: .*12 equations, 9 .*over-constrained"):
        checked(edited(toml=[("[workspace]", again)]))


def test_loops_that_cannot_close_at_home_are_named(edited, checked):
    """A rigid post on the base, a metre from the platform, which turns about a fixed centre and can't reach it."""
    post = joint("post_mount", "base", "post", '<origin xyz="1 0 0.45"/>')
    loop = '[[loop]]\nname = "post"\nkind = "point"\nframes = ["post", "platform_joint1"]\n\n[workspace]'
    robot = edited(urdf=[(LAST, f'<link name="post"/>{post}{LAST}')], toml=[("[workspace]", loop)])
    with pytest.raises(InputError, match=r"loop 'post' \(post and platform_joint1\) stays open by"):
        checked(robot)


def test_a_home_beyond_the_joint_limits_names_the_joint(edited, checked):
    """Leg 2's platform joint 2 m aside: its length would be 1.8 m (eq. 2), its slide ends at 0.65 m."""
    robot = edited(urdf=[('xyz="-0.193185165257814 0.051763809020504 0"', 'xyz="-0.19 2.0 0"')])
    with pytest.raises(InputError, match=r"home.*'leg2_slide' would be at 1\.79\d*; its limits are \[0\.35, 0\.65\]"):
        checked(robot)


def test_joint_limits_exceeded_within_the_workspace_name_joint_and_pose(edited, checked):
    """Leg 1's second universal angle is -0.324 rad at home: allowed there, not everywhere."""
    end = 'effort="10000" velocity="10"/>\n  </joint>\n  <link name="leg1_rod"/>'
    robot = edited(urdf=[(f'<limit lower="-1.4" upper="1.4" {end}', f'<limit lower="-0.35" upper="0.35" {end}')])
    with pytest.raises(
        InputError, match=r"workspace: pose \(rx = .* deg.*\): joint 'leg1_u2' would be at .*\[-0\.35, 0\.35\]"
    ):
        checked(robot)


def test_deeply_nested_and_huge_urdfs_are_refused(edited, checked):
    chain = "".join(
        f'<link name="c{i}"/>' + joint(f"f{i}", "base" if i == 0 else f"c{i - 1}", f"c{i}") for i in range(600)
    )
    with pytest.raises(InputError, match=r"joints; allowed are 500"):
        checked(edited(urdf=[(LAST, chain + LAST)]))


def test_a_missing_urdf_is_named(edited, checked):
    with pytest.raises((InputError, FileNotFoundError), match=r"absent\.urdf"):
        checked(edited(toml=[('urdf = "robot.urdf"', 'urdf = "absent.urdf"')]))
