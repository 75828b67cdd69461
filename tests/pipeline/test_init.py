"""kincal init: from a URDF or an MJCF alone to a robot.toml that runs."""

import re
import shutil
import tomllib
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kincal.urdf.assembly import assembled
from kincal.urdf.closed_chain import load_chain
from kincal.urdf.description import ROBOTS, load_robot
from kincal.urdf.input_files import read_text
from kincal.urdf.kinematics import at_home
from kincal.urdf.proposal import propose
from kincal.urdf.proposed_toml import robot_toml

DATA = Path(__file__).parents[1] / "data"
DEGREES = {"ups3_s": 3, "jugglebot": 6, "ur10": 6}


def pairs(loops) -> set[frozenset[str]]:
    return {frozenset(loop.frames) for loop in loops}


def written(file: Path):
    """The description in a proposal, from its text alone; its loops and workspace stand the model stage's checks."""
    description = load_robot(str(file)).description
    return description, assembled(description.mechanism, read_text(description.urdf), description.urdf)[1]


def urdf(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    return file


def link(*names: str) -> str:
    return "".join(f"<link name={quoteattr(name)}/>" for name in names)


def joint(name: str, parent: str, child: str, kind: str = "fixed", xyz: str = "0 0 0", axis: str = "0 0 1") -> str:
    limit = "" if kind in ("fixed", "continuous") else '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    return (
        f'<joint name={quoteattr(name)} type="{kind}"><parent link={quoteattr(parent)}/>'
        f'<child link={quoteattr(child)}/><origin xyz="{xyz}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


# Shipped robots, without their robot.toml


@pytest.mark.parametrize("name", DEGREES)
def test_a_shipped_robot_is_found_again(name, cli, tmp_path):
    """Its true loops, actuators and tool; and kincal takes the proposal."""
    folder = tmp_path / "my"
    folder.mkdir()
    shutil.copy(ROBOTS / name / "robot.urdf", folder / "my robot.urdf")
    answer = cli("init", folder / "my robot.urdf")
    assert answer.status == 0, answer.err
    assert f"{DEGREES[name]} degrees of freedom" in answer.out
    found, report = written(folder / "robot.toml")
    truth = load_robot(name).description
    assert pairs(found.loop) == pairs(truth.loop)
    assert {loop.kind for loop in found.loop} <= {"point"}
    assert found.name == "my"  # not the name of the robot that comes with kincal
    assert (found.base_frame, found.tool_frame) == (truth.base_frame, truth.tool_frame)
    assert set(found.actuated) == set(truth.actuated)
    assert report.mobility == DEGREES[name]
    axes = [set(getattr(d.workspace, kind)) for d in (found, truth) for kind in ("translation_mm", "rotation_deg")]
    assert axes[:2] == axes[2:]
    assert ("guess" in answer.err) == bool(found.loop)  # their zero configurations don't close the loops
    ran = cli("run", folder / "robot.toml", "--until", "model")
    assert (ran.status, ran.out) == (0, "")


@pytest.mark.parametrize("name", ["gough_stewart", "linear_delta", "rps3", "ups2_u"])
def test_other_shipped_robots_are_found_again(name):
    """None of their drawings closes the loops; the delta's rods come in pairs, its first leg's meet as drawn."""
    truth = load_robot(name).description
    proposal = propose(truth.urdf)
    assert (proposal.how, proposal.problem) == ("paired", None)
    assert pairs(proposal.mechanism.loop) == pairs(truth.loop)
    assert proposal.mechanism.tool_frame == truth.tool_frame
    assert set(proposal.mechanism.actuated) == set(truth.actuated)
    for kind in ("translation_mm", "rotation_deg"):
        assert set(getattr(proposal.mechanism.workspace, kind)) == set(getattr(truth.workspace, kind))


@pytest.mark.parametrize("name", ["ups3_frame", "ups3_mjcf", "ups3_frame_mjcf"])
def test_frame_loops_and_mjcf(name, tmp_path, cli):
    """Frame loops where point loops would leave the rods turning; an MJCF has its loops."""
    drawing = shutil.copy(next(f for f in (DATA / name).iterdir() if f.suffix != ".toml"), tmp_path)
    answer = cli("init", drawing)
    assert answer.status == 0, answer.err
    assert "3 loops, 3 degrees of freedom, tool frame 'platform'" in answer.out
    found, report = written(tmp_path / "robot.toml")
    truth = load_robot(str(DATA / name)).description
    assert pairs(found.loop) == pairs(truth.loop)
    assert [loop.kind for loop in found.loop] == ["frame"] * len(truth.loop)
    assert set(found.actuated) == set(truth.actuated)
    assert report.mobility == 3


def test_a_proposal_for_an_mjcf_is_identified(start, tmp_path, cli):
    """From the drawing to identified parameters, named by the file's own equalities."""
    drawing = shutil.copy(DATA / "ups3_mjcf" / "robot.xml", tmp_path)
    assert cli("init", drawing).status == 0
    run, _ = start(tmp_path / "store", "plan.poses=20", robot=tmp_path / "robot.toml")
    found = run.until("identify")[0].shipped
    assert {"leg2.platform.x", "connect1.leg3_tip.z", "leg1_slide.zero"} <= set(found.names)
    assert found.rank == 27  # as of ups3_s: the same robot


# Loops of drawings that are closed


def drawn_closed(name: str, folder: Path) -> str:
    """The URDF of a robot with its joints' zeros moved to home: the drawing is closed."""
    description = load_robot(name if (ROBOTS / name).is_dir() else str(DATA / name)).description
    text = description.urdf.read_text()
    chain = at_home(load_chain(description.mechanism, text, description.urdf), None)
    for j, joint_name in enumerate(chain.joint_names):
        q, axis = chain.home[j], chain.axes[j]
        pattern = (
            rf'(<joint name="{joint_name}".*?<origin xyz=")([^"]*)("[^>]*?)/>(.*?lower=")([^"]*)(" upper=")([^"]*)"'
        )
        before = re.search(pattern, text, re.DOTALL)
        xyz = np.array(before[2].split(), dtype=float) + (q * axis if chain.prismatic[j] else 0)
        rpy = "" if chain.prismatic[j] else ' rpy="{} {} {}"'.format(*(q * axis))
        low, high = float(before[5]) - q, float(before[7]) - q
        moved = f'{before[1]}{" ".join(map(repr, map(float, xyz)))}{before[3]}{rpy}/>{before[4]}{low}{before[6]}{high}"'
        text = text[: before.start()] + moved + text[before.end() :]
    return text


@pytest.mark.parametrize("name, kind", [("ups3_s", "point"), ("ups3_frame", "frame")])
def test_frames_that_coincide_as_drawn_are_loops(name, kind, tmp_path):
    proposal = propose(urdf(tmp_path, drawn_closed(name, tmp_path)))
    assert (proposal.how, proposal.problem, proposal.mobility) == ("coinciding", None, 3)
    truth = load_robot("ups3_s").description
    assert pairs(proposal.mechanism.loop) == pairs(truth.loop)
    assert {loop.kind for loop in proposal.mechanism.loop} == {kind}
    assert [loop.name for loop in proposal.mechanism.loop] == ["leg1", "leg2", "leg3"]
    assert proposal.mechanism.tool_frame == "platform"
    assert set(proposal.mechanism.actuated) == set(truth.actuated)
    assert proposal.not_as_drawn is None


def test_frames_that_nearly_coincide_are_loops_and_the_gap_is_said(tmp_path, cli):
    text = drawn_closed("ups3_s", tmp_path).replace('"0.14142135623731 0.14142135623731 0"', '"0.1416 0.1414 0"')
    answer = cli("init", urdf(tmp_path, text))
    assert answer.status == 0
    assert "up to 0.18 mm apart" in answer.err
    content = (tmp_path / "robot.toml").read_text()
    assert 'frames = ["leg1_tip", "platform_joint1"] # 0.18 mm apart as drawn' in content
    found, report = written(tmp_path / "robot.toml")
    assert pairs(found.loop) == pairs(load_robot("ups3_s").description.loop)
    assert report.mobility == 3


def test_two_bodies_that_meet_twice_meet_as_a_hinge(tmp_path):
    """The second point adds two equations of three: it is named in a comment, not as a loop."""
    text = '<robot name="hinge">' + link("base", "cross", "arm", "fork", "yoke")
    text += joint("u", "base", "cross", "revolute", axis="1 0 0") + joint("v", "cross", "arm", "revolute", axis="0 1 0")
    text += joint("w", "base", "fork", "revolute", xyz="0 0 2") + joint("x", "fork", "yoke", "revolute", axis="1 0 0")
    for x in (1, 2):
        text += link(f"arm{x}", f"yoke{x}")
        text += joint(f"am{x}", "arm", f"arm{x}", xyz=f"{x} 0 1") + joint(f"ym{x}", "yoke", f"yoke{x}", xyz=f"{x} 0 -1")
    proposal = propose(urdf(tmp_path, text + "</robot>"))
    assert proposal.how == "coinciding"
    assert [{end.name for end in meeting.ends} for meeting in proposal.meetings] == [{"arm1", "yoke1"}]
    assert [{end.name for end in meeting.ends} for meeting in proposal.candidates] == [{"arm2", "yoke2"}]


FOUR_BAR = (
    '<robot name="four_bar">' + link("ground", "crank", "coupler", "rocker", "rocker_end", "pivot")
    + joint("j1", "ground", "crank", "revolute", axis="0 0 1")
    + joint("j2", "crank", "coupler", "revolute", xyz="0 1 0")
    + joint("j3", "coupler", "rocker", "revolute", xyz="2 0 0")
    + joint("mount", "rocker", "rocker_end", xyz="0 -1 0") + joint("base", "ground", "pivot", xyz="2 0 0") + "</robot>"
)  # fmt: skip


def test_a_loop_that_is_closed_on_the_base_and_is_over_constrained(tmp_path, cli):
    """Found and written; that kincal will refuse it stands at the top."""
    answer = cli("init", urdf(tmp_path, FOUR_BAR))
    assert answer.status == 0
    assert "over-constrained" in answer.err
    lines = (tmp_path / "robot.toml").read_text().splitlines()
    assert lines[0] == "#:schema ./robot.schema.json"
    (refused,) = (line for line in lines if line.startswith("# NOT READY"))
    assert "over-constrained" in refused
    found = load_robot(str(tmp_path / "robot.toml")).description
    assert pairs(found.loop) == {frozenset({"rocker_end", "pivot"})}
    assert found.actuated == ("j1",)
    ran = cli("run", tmp_path / "robot.toml", "--until", "model")
    assert ran.status == 2
    assert "over-constrained" in ran.err


def test_slides_of_length_zero_make_no_loops(tmp_path):
    """A gantry: all its frames coincide as drawn."""
    text = '<robot name="gantry">' + link("base", "x", "y", "z", "mark")
    text += joint("sx", "base", "x", "prismatic", axis="1 0 0") + joint("sy", "x", "y", "prismatic", axis="0 1 0")
    text += joint("sz", "y", "z", "prismatic", axis="0 0 1") + joint("m", "base", "mark") + "</robot>"
    proposal = propose(urdf(tmp_path, text))
    assert (proposal.how, proposal.meetings, proposal.problem) == ("none", (), None)
    assert proposal.mechanism.actuated == ("sx", "sy", "sz")
    assert proposal.mechanism.tool_frame == "z"
    assert set(proposal.mechanism.workspace.translation_mm) == {"x", "y", "z"}


def test_frames_that_stay_apart_are_candidates_only(tmp_path, cli):
    """Two arms that can't reach each other: their ends are named, nothing is claimed."""
    text = '<robot name="arms">' + link("base", *(f"{side}_{part}" for side in "ab" for part in ("arm", "end")))
    for side, x in (("a", 0), ("b", 9)):
        text += joint(f"{side}_turn", "base", f"{side}_arm", "revolute", xyz=f"{x} 0 0")
        text += joint(f"{side}_mount", f"{side}_arm", f"{side}_end", xyz="1 0 0")
    answer = cli("init", urdf(tmp_path, text + "</robot>"))
    assert answer.status == 0
    assert "no frames of different branches coincide" in answer.err
    assert "# a_end and b_end: 9000 mm apart as drawn" in (tmp_path / "robot.toml").read_text()
    assert "the tool shows 1 of them" in answer.err
    assert load_robot(str(tmp_path / "robot.toml")).description.loop == ()


def test_limits_that_exclude_the_drawing_and_most_of_the_workspace(tmp_path, cli):
    """The ranges shrink until they fit; where home itself is out, another is found."""
    text = (ROBOTS / "ups3_s" / "robot.urdf").read_text()
    narrow = text.replace('lower="0.35" upper="0.65"', 'lower="0.49" upper="0.505"')
    assert cli("init", urdf(tmp_path, narrow)).status == 0
    found, _ = written(tmp_path / "robot.toml")
    assert max(high for _, high in found.workspace.rotation_deg.values()) < 10
    elsewhere = text.replace('lower="0.35" upper="0.65"', 'lower="0.51" upper="0.60"', 1)
    assert cli("init", urdf(tmp_path, elsewhere), "--output", "other.toml").status == 0
    found, report = written(tmp_path / "other.toml")
    assert found.workspace.home_rotation_deg is not None
    assert report.mobility == 3


# What is written


PRINTABLE = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Zl", "Zp"]), min_size=1, max_size=12)


@settings(max_examples=25)
@given(names=st.lists(PRINTABLE, min_size=4, max_size=4, unique=True))
def test_names_stand_in_the_file_as_they_are(names, tmp_path_factory):
    """Quotes, hashes, brackets, dots and spaces included."""
    folder = tmp_path_factory.mktemp("names")
    base, turn, arm, tip = names
    if any(name != " ".join(name.split()) or name == "universe" for name in names):
        return  # a name that XML, or pinocchio, would change
    text = f"<robot name={quoteattr(base)}>" + link(base, arm, tip) + joint(turn, base, arm, "continuous")
    file = urdf(folder, text + joint(f"{turn}!", arm, tip, xyz="0.5 0 0") + "</robot>")
    toml = robot_toml(propose(file), file, folder / "robot.toml")
    (folder / "robot.toml").write_text(toml, encoding="utf-8")
    found, report = written(folder / "robot.toml")
    assert (found.base_frame, found.tool_frame, found.actuated) == (base, tip, (turn,))
    assert report.mobility == 1


def test_it_says_why_and_what_else(cli, tmp_path):
    shutil.copy(ROBOTS / "jugglebot" / "robot.urdf", tmp_path)
    assert cli("init", "robot.urdf").status == 0
    text = (tmp_path / "robot.toml").read_text()
    for words in (
        "# Proposed by `kincal init`",
        "guess by names and distances",
        "220 mm apart",
        "on the same body: leg1_ball",
        "# not as drawn: workspace: with the tool at home, joint",
        '# table = "poses.csv"',
        "# [actuator.leg1_slide]",
    ):
        assert words in text
    content = tomllib.loads(text)
    assert content["urdf"] == "robot.urdf"
    assert {"tolerance", "sensor", "plan", "measure"} <= set(content)


def test_the_output_may_stand_elsewhere(cli, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    shutil.copy(ROBOTS / "ups3_s" / "robot.urdf", tmp_path / "a")
    answer = cli("init", Path("a") / "robot.urdf", "--output", Path("b") / "mine.toml")
    assert answer.status == 0
    assert "b/mine.toml: 3 loops" in answer.out
    assert tomllib.loads((tmp_path / "b" / "mine.toml").read_text())["urdf"] == "../a/robot.urdf"
    assert written(tmp_path / "b" / "mine.toml")[1].mobility == 3


# What is refused


def refused(answer, *said: str) -> None:
    assert (answer.status, answer.out) == (2, "")
    assert len(answer.err.splitlines()) == 1
    for words in said:
        assert words in answer.err


def test_nothing_is_overwritten(cli, tmp_path):
    shutil.copy(ROBOTS / "ups3_s" / "robot.urdf", tmp_path)
    (tmp_path / "robot.toml").write_text("precious")
    refused(cli("init", "robot.urdf"), "robot.toml", "exists", "--output")
    refused(cli("init", "robot.urdf", "--output", "robot.toml"), "robot.toml", "exists")
    assert (tmp_path / "robot.toml").read_text() == "precious"
    (tmp_path / "robot.toml").unlink()
    (tmp_path / "robot.toml").symlink_to("nowhere.toml")
    refused(cli("init", "robot.urdf"), "exists")
    assert not (tmp_path / "nowhere.toml").exists()


@pytest.mark.parametrize(
    "text, said",
    [
        (None, ["robot.urdf", "can't be read"]),
        ("<robot", ["robot.urdf", "not well-formed"]),
        ("<html></html>", ["<html>", "<robot>", "<mujoco>"]),
        ('<robot name="r"><link name="stone"/></robot>', ["robot.urdf", "no joint moves"]),
        ("<mujoco><worldbody><body/></worldbody></mujoco>", ["robot.urdf", "no joint moves"]),
    ],
)
def test_a_drawing_that_is_none(cli, tmp_path, text, said):
    if text is not None:
        urdf(tmp_path, text)
    refused(cli("init", "robot.urdf"), *said)
    assert not (tmp_path / "robot.toml").exists()


def test_a_folder_that_is_not_there(cli, tmp_path):
    shutil.copy(ROBOTS / "ups3_s" / "robot.urdf", tmp_path)
    refused(cli("init", "robot.urdf", "--output", Path("absent") / "robot.toml"), "absent", "can't be written")
