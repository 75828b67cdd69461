"""Loops that repeat what the rest of the mechanism imposes already: refused with the reason, never miscounted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kincal.urdf.errors import InputError
from kincal.urdf.workspace import mobility

LIMIT = '<limit lower="-1.4" upper="1.4" effort="10000" velocity="10"/>'
TWO_RINGS = Path(__file__).parents[1] / "data" / "two_rings"


def link(name: str, parent: str, xyz: str = "0 0 0", rpy: str = "0 0 0", axis: str = "", kind: str = "revolute") -> str:
    """A link called `name` and the joint `name`_joint that carries it: fixed, where it has no axis."""
    moving = f'<axis xyz="{axis}"/>{LIMIT}' if axis else ""
    return (
        f'<link name="{name}"/><joint name="{name}_joint" type="{kind if axis else "fixed"}">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}" rpy="{rpy}"/>{moving}</joint>'
    )


@pytest.fixture
def four_bar(tmp_path):
    """four_bar(kind, rpy, extra): a planar four-bar linkage in a plane turned by rpy, its coupler's end closed by a
    loop of that kind; extra: one more passive joint, between the rocker's pin and the ground."""

    def write(kind: str, rpy: str = "0 0 0", extra: str = "") -> str:
        links = [
            '<link name="base"/>',
            link("ground", "base", rpy=rpy),
            link("crank", "ground", axis="0 0 1"),
            link("coupler", "crank", "0 0.2 0", axis="0 0 1"),
            link("coupler_end", "coupler", "0.4 0.1 0"),
            link("rocker", "ground", "0.5 0 0", axis="0 0 1"),
            link("rocker_fork", "rocker", axis=extra),
            link("rocker_end", "rocker_fork", "-0.1 0.3 0", axis="0 0 1" if kind == "frame" else ""),
        ]
        (tmp_path / "robot.urdf").write_text(f'<robot name="four_bar">{"".join(links)}</robot>')
        (tmp_path / "robot.toml").write_text(
            f"""
            name = "four_bar"
            urdf = "robot.urdf"
            base_frame = "ground"
            tool_frame = "rocker"
            actuated = ["crank_joint"]
            loop = [{{ name = "bar", kind = "{kind}", frames = ["coupler_end", "rocker_end"] }}]
            workspace.rotation_deg = {{ z = [-5, 5] }}
            measure.source = "virtual"
            """
        )
        return str(tmp_path)

    return write


def test_two_rings_are_refused_with_the_loop_and_what_to_do(checked):
    """Six revolutes through one point: three of the frame loop's equations keep that point where it is already."""
    with pytest.raises(InputError) as refusal:
        checked(TWO_RINGS)
    message = str(refusal.value)
    for words in (
        "6 equations, 3 of them independent",
        "over-constrained",
        r"loop 'ring2' \(position\)",
        "point loop",
        r"passive joints .*\(3 in all\)",
    ):
        assert re.search(words, message), f"{words!r} is not in {message!r}"


def test_two_rings_keep_three_degrees_of_freedom(robot):
    """Not zero, as joints less equations would have it."""
    assert mobility(robot("two_rings").chain) == 3


def test_two_rings_drawn_with_rounded_coordinates_are_refused_all_the_same(edited, checked):
    """Ring 2's axes pass each other at half a micrometre: the equations differ by rounding, not in what they impose."""
    off = [
        ('link="ring2_fork"/>\n    <origin xyz="0 0 0"/>', 'link="ring2_fork"/>\n    <origin xyz="0 5e-7 0"/>'),
        ('link="ring2_tip"/>\n    <origin xyz="0 0 0"/>', 'link="ring2_tip"/>\n    <origin xyz="0 -5e-7 0"/>'),
    ]
    with pytest.raises(InputError, match=r"6 equations, 3 of them independent .*over-constrained"):
        checked(edited(urdf=off, robot=str(TWO_RINGS)))


def test_two_rings_with_the_passive_joints_that_are_asked_for_are_accepted(edited, checked):
    """Three short slides take up what the axes of real rings miss each other by."""
    slides = [
        link(name, parent, axis=axis, kind="prismatic")
        for name, parent, axis in (("x", "ring2_tip", "1 0 0"), ("y", "x", "0 1 0"), ("ring2_end", "y", "0 0 1"))
    ]
    report = checked(
        edited(
            urdf=[("</robot>", "".join(slides) + "</robot>")],
            toml=[('"ring2_tip", "platform"', '"ring2_end", "platform"')],
            robot=str(TWO_RINGS),
        )
    )
    assert report.mobility == 3
    assert report.worst_condition < 10


@pytest.mark.parametrize("rpy", ["0 0 0", "0.3 0.5 0.2"])
@pytest.mark.parametrize(
    "kind, counted, involved, missing",
    [
        ("point", "3 equations, 2 of them", r"\(position\)", 1),  # out of the plane
        ("frame", "6 equations, 3 of them", r"\(position and orientation\)", 3),  # and about two of its axes
    ],
)
def test_a_planar_four_bar_is_refused(kind, counted, involved, missing, rpy, four_bar, checked):
    """In a plane two equations close a pin; the loop's other ones hold whatever the crank does."""
    with pytest.raises(InputError) as refusal:
        checked(four_bar(kind, rpy))
    message = str(refusal.value)
    for words in (counted, "over-constrained", rf"loop 'bar' {involved}", rf"passive joints .*\({missing} in all\)"):
        assert re.search(words, message), f"{words!r} is not in {message!r}"


@pytest.mark.parametrize("out_of_plane", [1e-9, 1e-6, 5e-5])
@pytest.mark.parametrize("kind, missing", [("point", 1), ("frame", 3)])
def test_a_four_bar_that_rounding_keeps_open_is_refused_with_what_to_do(out_of_plane, kind, missing, four_bar, checked):
    """The coupler's pin a little out of the plane: no crank angle closes that loop, and that is not what is wrong."""
    folder = Path(four_bar(kind))
    text = (folder / "robot.urdf").read_text()
    (folder / "robot.urdf").write_text(text.replace("0.4 0.1 0", f"0.4 0.1 {out_of_plane}"))
    with pytest.raises(InputError, match=rf"'bar'.* stays open by .*over-constrained.*passive joints .*\({missing} in"):
        checked(folder)


def test_a_loop_that_is_far_open_is_not_called_over_constrained(four_bar, checked):
    folder = Path(four_bar("point"))
    text = (folder / "robot.urdf").read_text()
    (folder / "robot.urdf").write_text(text.replace("0.4 0.1 0", "0.4 0.1 0.01"))
    with pytest.raises(InputError, match=r"stays open by 0\.01 m or rad$"):
        checked(folder)


def test_a_four_bar_with_a_universal_joint_for_one_pin_is_accepted(four_bar, checked):
    report = checked(four_bar("point", "0.3 0.5 0.2", extra="1 0 0"))
    assert report.mobility == 1


def test_a_repeated_loop_is_named_with_the_one_it_repeats(edited, checked):
    """A loop closed twice: each of the two holds what the other does."""
    again = '[[loop]]\nname = "again"\nkind = "point"\nframes = ["leg1_tip", "platform_joint1"]\n\n[workspace]'
    with pytest.raises(InputError, match=r"by loop 'leg1' \(position\), 'again' \(position\);"):
        checked(edited(toml=[("[workspace]", again)]))
