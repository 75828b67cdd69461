"""What `kincal export` hands out, read by others: Pinocchio alone, the standard library's TOML, JSON and CSV."""

import csv
import json
import shutil
import tomllib
import xml.etree.ElementTree as Xml
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import BuiltRobot
from kincal.pipeline.export import document as json_document
from kincal.pipeline.export import folder as written_folder
from kincal.pipeline.export.calibration_json import read_calibration
from kincal.pipeline.export.document import export as export_document
from kincal.pipeline.export.folder import export as export_folder
from kincal.pipeline.export.identified import Exported, IdentifiedRobot, identified_robot
from kincal.pipeline.export.urdf import calibrated_urdf, require_urdf
from kincal.pipeline.run.runner import Run
from kincal.urdf.closed_chain import load_chain
from kincal.urdf.description import ROBOTS, load_robot
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import inverse, tool_pose, tree
from kincal.urdf.rigid_motion import Motion, from_zyx_angles, zyx_angles
from kincal.urdf.workspace import grid

DATA = Path(__file__).parents[1] / "data"
FOLDERS = {
    "ups3_s": ROBOTS / "ups3_s",
    "ups3_frame": DATA / "ups3_frame",
    "ur10": ROBOTS / "ur10",
    "jugglebot": ROBOTS / "jugglebot",
}
POSES = {"ups3_s": 12, "ups3_frame": 12, "ur10": 30, "jugglebot": 30}
STRANGE = 'leg "1" & <tip> é\'s'


@dataclass(frozen=True)
class Case:
    """A robot, as identified and as exported."""

    run: Run
    calibrated: IdentifiedRobot
    folder: Path
    exported: Exported

    @property
    def toml(self) -> dict:
        return tomllib.loads((self.folder / "robot.toml").read_text(encoding="utf-8"))

    @property
    def urdf(self) -> str:
        return (self.folder / "robot.urdf").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def case(start, finished, tmp_path_factory):
    """case(robot): exported once a module, from a copy: other tests count the artifacts of the finished store."""
    made: dict[str, Case] = {}
    store = shutil.copytree(finished.store, tmp_path_factory.mktemp("exported") / "store")

    def make(robot: str) -> Case:
        if robot not in made:
            folder = tmp_path_factory.mktemp("exported")
            channels = () if robot == "ups3_s" else ('measure.channels=["orientation", "position"]',)
            run, _ = start(store, f"plan.poses={POSES[robot]}", *channels, robot=FOLDERS[robot])
            exported = export_folder(run, folder / "calibrated")
            made[robot] = Case(run, identified_robot(run), folder / "calibrated", exported)
        return made[robot]

    return make


# With Pinocchio alone


class Alone:
    """A URDF's frames by Pinocchio's own forward kinematics."""

    def __init__(self, urdf: str) -> None:
        self.model = pin.buildModelFromXML(urdf)
        self.data = self.model.createData()
        self.joints = list(self.model.names)[1:]

    def at(self, q: dict[str, float]) -> None:
        full = pin.neutral(self.model)
        for name, value in q.items():
            joint = self.model.joints[self.model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        pin.framesForwardKinematics(self.model, self.data, full)

    def frame(self, name: str) -> pin.SE3:
        return self.data.oMf[self.model.getFrameId(name, pin.FrameType.BODY)]

    def between(self, first: str, second: str) -> pin.SE3:
        return self.frame(first).actInv(self.frame(second))


def loop_errors(alone: Alone, loops: list[dict]) -> np.ndarray:
    errors = [np.zeros(0)]
    for loop in loops:
        apart = alone.between(*loop["frames"])
        errors.append(apart.translation)
        if loop["kind"] == "frame":
            errors.append(pin.log3(apart.rotation))
    return np.concatenate(errors)


@pytest.mark.parametrize("robot", FOLDERS)
def test_pinocchio_alone_predicts_what_kincal_predicts(case, robot):
    """From the two files: actuators' readings to joints, the loops closed by scipy, the target in the instrument."""
    found = case(robot)
    alone, toml, calibrated = Alone(found.urdf), found.toml, found.calibrated
    chain = calibrated.robot.chain
    rows = np.r_[0:3, len(calibrated.readings) - 3 : len(calibrated.readings)]
    closed = calibrated.robot.close(calibrated.readings[rows])
    for row, near in zip(rows, closed.q, strict=True):
        q = dict(zip(chain.joint_names, near, strict=True))
        for name, reading in zip(toml["actuated"], calibrated.readings[row], strict=True):
            q[name] = toml["actuator"][name]["zero"] + toml["actuator"][name]["gain"] * reading
        passive = [name for name in alone.joints if name not in toml["actuated"]]

        def errors(values, q=q, passive=passive):
            alone.at(q | dict(zip(passive, values, strict=True)))
            return loop_errors(alone, toml.get("loop", []))

        if passive:
            start = np.array([q[name] for name in passive]) + 1e-3
            solved = root(errors, start, tol=1e-13)
            assert np.abs(errors(solved.x)).max() < 1e-12
        else:
            alone.at(q)
        seen = alone.between("instrument", "target")
        assert np.allclose(seen.translation, calibrated.predicted.translation[row], rtol=0, atol=1e-10)
        assert np.allclose(seen.rotation, calibrated.predicted.rotation[row], rtol=0, atol=1e-10)
        tool = alone.between(toml["base_frame"], toml["tool_frame"])
        assert np.allclose(tool.homogeneous[:3, 3], calibrated.tool.translation[row], rtol=0, atol=1e-10)


@pytest.mark.parametrize("robot", FOLDERS)
def test_the_robot_is_otherwise_the_drawing(case, robot):
    """Joint types, names, limits and all that is no origin; the description but for its actuators."""
    found = case(robot)
    before, after = Xml.parse(FOLDERS[robot] / "robot.urdf").getroot(), Xml.fromstring(found.urdf)

    def rest(element: Xml.Element, names: set[str]) -> list:
        kept = [e for e in element if e.get("name") in names]
        return [[(p.tag, p.attrib) for p in e.iter() if p.tag != "origin"] for e in kept]

    names = {element.get("name", "") for element in before}
    assert rest(after, names) == rest(before, names)
    new = {element.get("name") for element in after} - names
    assert new == {"instrument", "instrument_mount", "target", "target_mount"}
    drawn = tomllib.loads((FOLDERS[robot] / "robot.toml").read_text())
    exported = found.toml
    for key in ("base_frame", "tool_frame", "loop", "workspace", "tolerance", "name", "seed", "actuated"):
        assert exported.get(key) == drawn.get(key)
    assert exported["urdf"] == "robot.urdf"
    assert exported["plan"]["poses"] == POSES[robot]  # a --set
    assert list(exported["actuator"]) == exported["actuated"]


def test_comments_stay_and_the_first_line_says_what_it_is(case):
    found = case("ups3_s")
    first, *rest = (found.folder / "robot.toml").read_text().splitlines()
    shipped = found.calibrated.found
    assert first.startswith("# kincal export: ups3_s, identified from 12 poses (virtual: orientation)")
    assert f"chi-square {shipped.chi_square:.5g}" in first
    assert "# a slide's value is its leg's length [m]" in "\n".join(rest)
    assert first[2:] in found.urdf
    assert "<!-- 3-UPS/S platform: a = 0.30" in found.urdf
    assert sorted(p.name for p in found.folder.iterdir()) == ["parameters.csv", "robot.toml", "robot.urdf"]


def test_the_exported_folder_is_a_robot(cli, case, store):
    found = case("ups3_s")
    answer = cli("run", found.folder, "--until", "identify", "--store", store)
    assert answer.status == 0, answer.err
    answer = cli("export", found.folder / "robot.toml", "--format", "urdf", "--output", "again", "--store", store)
    assert answer.status == 0, answer.err
    assert "'target_2' in link 'instrument_2'" in answer.out


def test_relative_data_paths_still_lead_to_their_files(start, finished, robot_folder, tmp_path):
    (robot_folder / "data").mkdir()
    finished.table.to_csv(robot_folder / "data" / "day 1.csv", index=False)
    toml = robot_folder / "robot.toml"
    text = toml.read_text().replace('source = "virtual"', 'table = "data/day 1.csv"')
    toml.write_text(text.replace("seed = 0", "seed = 3"))
    run, _ = start(tmp_path / "store", robot=toml)
    (tmp_path / "deep").mkdir()
    export_folder(run, tmp_path / "deep" / "out")
    assert (
        tomllib.loads((tmp_path / "deep/out/robot.toml").read_text())["measure"]["table"]
        == "../../robot/data/day 1.csv"
    )
    again, _ = start(tmp_path / "store", robot=tmp_path / "deep" / "out")
    assert again.until("measure")[0].table.equals(run.until("measure")[0].table)
    absolute, _ = start(tmp_path / "store", f"measure.table={robot_folder / 'data' / 'day 1.csv'}", robot=toml)
    toml.write_text(toml.read_text().replace("data/day 1.csv", str(robot_folder / "data" / "day 1.csv")))
    export_folder(absolute, tmp_path / "out")
    assert Path(tomllib.loads((tmp_path / "out/robot.toml").read_text())["measure"]["table"]).is_absolute()


# Any parameters, through the function that writes the URDF


def compare(built: BuiltRobot, text: str, mechanism, names, seed: int) -> None:
    """Frames of the written URDF against the built robot's, at configurations that need not close the loops."""
    chain, alone = built.chain, Alone(text)
    random = np.random.default_rng(seed)
    q = random.uniform(-1, 1, (3, chain.n_joints))
    frames = tree(chain, q)
    predicted = built.measured(tool_pose(chain, frames))
    for row, values in enumerate(q):
        alone.at(dict(zip(chain.joint_names, values, strict=True)))
        seen = alone.between(names.instrument, names.target)
        scale = 1e-14 * (10 + np.abs(predicted.translation[row]).max())
        assert np.allclose(seen.translation, predicted.translation[row], rtol=0, atol=scale)
        assert np.allclose(seen.rotation, predicted.rotation[row], rtol=0, atol=1e-13)
        for loop, pair in zip(chain.loops, names.loop_frames, strict=True):
            for joint, body, frame in zip(loop.joints, loop.bodies, pair, strict=True):
                where = frames.point(joint, chain.translation[body])[row]
                turned = frames.turned(joint, chain.rotation[body])[row]
                assert np.allclose(alone.frame(frame).translation, where, rtol=0, atol=1e-13)
                assert np.allclose(alone.frame(frame).rotation, turned, rtol=0, atol=1e-13)
    loops = zip(mechanism.loop, names.loop_frames, strict=True)
    update = {"loop": tuple(loop.model_copy(update={"frames": pair}) for loop, pair in loops)}
    again = load_chain(mechanism.model_copy(update=update), text, Path("robot.urdf"))
    assert np.allclose(again.rotation, chain.rotation, rtol=0, atol=2e-15)
    assert np.allclose(again.translation, chain.translation, rtol=0, atol=2e-15)


@pytest.mark.parametrize("name", FOLDERS)
@given(seed=st.integers(0, 2**32 - 1), tolerances=st.floats(1, 10), far=st.floats(1e-3, 100))
def test_any_parameters(robot, name, seed, tolerances, far):
    loaded = robot(name)
    random = np.random.default_rng([seed, 1])
    w, t = (Motion(Rotation.random(rng=random).as_matrix(), far * random.normal(size=3)) for _ in range(2))
    built = loaded.model.robot(loaded.random_parameters(seed, tolerances, w, t))
    mechanism, text = loaded.description.mechanism, loaded.description.urdf.read_text()
    names = calibrated_urdf(text, built, mechanism, ["any -- text -", "and <more> & more\n"])
    compare(built, names.text, mechanism, names, seed)


SMALL_ANGLES = st.sampled_from([0.0, *(10.0**-k for k in range(1, 18))])
TURN = st.floats(-np.pi, np.pi)


@given(yaw=TURN, roll=TURN, apart=SMALL_ANGLES, sign=st.sampled_from([-1, 1]), noise=st.integers(0, 999))
def test_rpy_near_gimbal_lock(yaw, roll, apart, sign, noise):
    """Yaw, pitch and roll give a rotation back to machine precision, whatever its last bits are."""
    rotation = from_zyx_angles(np.array([yaw, sign * (np.pi / 2 - apart), roll]))
    rotation = rotation + 1e-16 * np.random.default_rng(noise).uniform(-1, 1, (3, 3))
    assert np.allclose(from_zyx_angles(zyx_angles(rotation)), rotation, rtol=0, atol=2e-15)


@given(TURN, TURN, TURN)
def test_rpy(yaw, pitch, roll):
    rotation = from_zyx_angles(np.array([yaw, pitch, roll]))
    assert np.allclose(from_zyx_angles(zyx_angles(rotation)), rotation, rtol=0, atol=2e-15)


@given(apart=SMALL_ANGLES, seed=st.integers(0, 2**32 - 1))
def test_a_urdf_near_gimbal_lock(robot, apart, seed):
    """All placements at pitch = +-90 degrees, through Pinocchio's own parser."""
    loaded = robot("ups3_frame")
    random, n = np.random.default_rng(seed), len(loaded.chain.rotation)
    pitch = random.choice([-1, 1], n) * (np.pi / 2 - apart)
    turned = from_zyx_angles(np.stack([random.uniform(-3, 3, n), pitch, random.uniform(-3, 3, n)], axis=1))
    frame = Motion(turned[0], random.normal(size=3))
    chain = loaded.chain.with_geometry(turned, loaded.chain.translation)
    built = BuiltRobot(chain, loaded.model.actuators, frame.inverse(), frame)
    mechanism, text = loaded.description.mechanism, loaded.description.urdf.read_text()
    names = calibrated_urdf(text, built, mechanism, [])
    compare(built, names.text, mechanism, names, seed)


SHARED = (
    ("leg1_rod", "platform_joint1"),  # a link that moves; one that two loops share
    ("leg2_tip_mount", "platform_joint1"),  # a fixed joint's name stands for its link
    ("base", "platform"),  # the base's and the tool's own links
)


def test_frames_that_serve_something_else_stay_where_they_are(robot):
    loaded = robot("ups3_s")
    text, mechanism = loaded.description.urdf.read_text(), loaded.description.mechanism
    loops = zip(mechanism.loop, SHARED, strict=True)
    mechanism = mechanism.model_copy(update={"loop": tuple(x.model_copy(update={"frames": f}) for x, f in loops)})
    text = text.replace(  # names that are taken, and a bracket between moving joints
        "</robot>",
        '<link name="instrument"/><joint name="target" type="fixed"><parent link="base"/><child link="instrument"/>'
        "</joint></robot>",
    ).replace('<parent link="leg1_cross"/>', '<parent link="between"/>')
    text = text.replace(
        '<link name="leg1_cylinder"/>',
        '<link name="leg1_cylinder"/><link name="between"/><joint name="bracket" type="fixed">'
        '<parent link="leg1_cross"/><child link="between"/><origin xyz="0.1 0.2 0.3" rpy="1 2 3"/></joint>',
    )
    chain = load_chain(mechanism, text, Path("robot.urdf"))
    random = np.random.default_rng(0)
    turned = chain.rotation @ Rotation.random(len(chain.rotation), rng=random).as_matrix()
    turned[chain.n_joints :] = chain.rotation[chain.n_joints :]
    moved = chain.with_geometry(turned, chain.translation + random.normal(size=chain.translation.shape))
    built = BuiltRobot(moved, loaded.model.actuators, Motion.from_vector(np.ones(6)), Motion.from_vector(-np.ones(6)))
    names = calibrated_urdf(text, built, mechanism, [])
    assert (names.instrument, names.target) == ("instrument_2", "target_2")
    assert names.loop_frames == (
        ("leg1_leg1_rod", "leg1_platform_joint1"),
        ("leg2_tip_mount", "leg2_platform_joint1"),
        ("leg3_base", "leg3_platform"),
    )
    alone = Alone(names.text)
    alone.at(dict.fromkeys(alone.joints, 0.0))
    bracket = alone.between("leg1_cross", "between")
    assert np.allclose(bracket.translation, [0.1, 0.2, 0.3])
    loops = zip(mechanism.loop, names.loop_frames, strict=True)
    mechanism = mechanism.model_copy(update={"loop": tuple(x.model_copy(update={"frames": f}) for x, f in loops)})
    again = load_chain(mechanism, names.text, Path("robot.urdf"))
    assert np.allclose(again.translation, moved.translation, rtol=0, atol=5e-15)
    assert np.allclose(again.rotation, moved.rotation, rtol=0, atol=5e-15)


def test_other_content_of_a_urdf_stays(robot):
    loaded = robot("ups3_s")
    inside = (
        "<!-- a comment & more --><?keep this?><material name='m'><color rgba='1 0 0 1'/></material>"
        "<gazebo reference='base'><plugin name='&lt;p&gt;' filename='a&amp;b.so'>text &lt; text</plugin></gazebo>"
    )
    text = loaded.description.urdf.read_text().replace('<link name="base"/>', f'<link name="base"/>{inside}')
    text = text.replace(
        '<link name="platform"/>', '<link name="platform"><inertial><mass value="2"/></inertial></link>'
    )
    built = loaded.model.robot(loaded.random_parameters(0))
    written = calibrated_urdf(text + "<!-- the end -->", built, loaded.description.mechanism, []).text
    for part in (
        "<!-- a comment & more -->",
        "<?keep this?>",
        "text &lt; text",
        'filename="a&amp;b.so"',
        "<!-- the end -->",
    ):
        assert part in written
    before, after = Xml.fromstring(text), Xml.fromstring(written)
    for tag in ("material", "gazebo", "link[@name='platform']"):
        assert Xml.tostring(after.find(tag)).strip() == Xml.tostring(before.find(tag)).strip()


def test_an_mjcf_is_refused():
    require_urdf("<robot name='r'/>")
    with pytest.raises(InputError, match="read from <mujoco>, no URDF; allowed is --format json"):
        require_urdf("<mujoco/>")


# Names


@pytest.fixture
def strange_robot(robot_folder) -> Path:
    """ups3_s with names that every format has to quote."""
    urdf, toml = robot_folder / "robot.urdf", robot_folder / "robot.toml"
    tree = Xml.parse(urdf)
    for element in tree.iter():
        for key, value in element.attrib.items():
            element.set(key, value.replace("leg1", STRANGE))
    tree.write(urdf, encoding="utf-8")
    quoted = STRANGE.replace('"', '\\"')
    loop = f'name = "{quoted}"'
    toml.write_text(toml.read_text().replace("leg1", quoted).replace(loop, 'name = "leg1"'), encoding="utf-8")
    return toml


def test_names_are_quoted(start, strange_robot, tmp_path):
    run, _ = start(tmp_path / "store", "plan.poses=12", robot=strange_robot)
    exported = export_folder(run, tmp_path / "a folder & 'more'")
    toml = tomllib.loads((exported.path / "robot.toml").read_text(encoding="utf-8"))
    assert toml["actuated"][0] == f"{STRANGE}_slide"
    assert f"{STRANGE}_slide" in toml["actuator"]
    with open(exported.path / "parameters.csv", encoding="utf-8", newline="") as file:
        names = [row["name"] for row in csv.DictReader(file)]
    assert f"{STRANGE}_u1.x" in names
    document = export_document(run, tmp_path / "out.json").document
    assert document["actuators"][0]["joint"] == f"{STRANGE}_slide"
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8")) == document


# Tables and documents


def test_parameters(cli, store, finished):
    """parameters.csv and the document's parameters against `inspect --json`."""
    settings = [part for setting in finished.settings for part in ("--set", setting)]
    arguments = ("ups3_s", *settings, "--store", store)
    inspected = json.loads(cli("inspect", *arguments, "--json").out)["parameters"]
    answer = cli("export", *arguments, "--format", "urdf")
    assert answer.status == 0, answer.err
    words = {"initial": "nominal", "final": "identified", "change": "change", "sigma": "std"}
    with open(store.parent / "ups3_s_calibrated" / "parameters.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(inspected)
    for row, expected in zip(rows, inspected, strict=True):
        assert (row["name"], row["unit"]) == (expected["name"], expected["unit"])
        assert row["identifiable"] == ("yes" if expected["identifiable"] else "no")
        for word, inspects in words.items():
            assert (float(row[word]) if row[word] else None) == expected[inspects]
    answer = cli("export", *arguments, "--format", "json")
    assert answer.status == 0, answer.err
    document = json.loads(answer.out, parse_constant=lambda constant: pytest.fail(f"{constant} is no JSON"))
    assert document["schema"] == "kincal-calibration-1"
    words |= {name: name for name in ("name", "unit", "low", "high", "identifiable")}
    for parameter, expected in zip(document["parameters"], inspected, strict=True):
        assert parameter == {word: expected[inspects] for word, inspects in words.items()}


@pytest.mark.parametrize("robot", FOLDERS)
def test_the_document_by_hand(case, robot):
    """Its numbers, put together by scipy's rotations, are the predicted poses."""
    found = case(robot)
    document = json.loads(json.dumps(export_document(found.run).document))
    calibrated = found.calibrated
    rows = [0, len(calibrated.readings) - 1]
    q = read_calibration(document).close(calibrated.readings[rows]).q

    def matrix(placement):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(placement["quaternion"]).as_matrix()
        pose[:3, 3] = placement["xyz"]
        return pose

    for row, values in zip(rows, q, strict=True):
        frames = {None: np.eye(4)}
        for joint, value in zip(document["joints"], values, strict=True):
            moved = np.eye(4)
            if joint["type"] == "prismatic":
                moved[:3, 3] = value * np.array(joint["axis"])
            else:
                moved[:3, :3] = Rotation.from_rotvec(value * np.array(joint["axis"])).as_matrix()
            frames[joint["name"]] = frames[joint["parent"]] @ matrix(joint["placement"]) @ moved
        for loop in document["loops"]:
            first, second = (frames[end["joint"]] @ matrix(end["placement"]) for end in loop["frames"])
            assert np.allclose(first[:3, 3], second[:3, 3], rtol=0, atol=1e-11)
            if loop["kind"] == "frame":
                assert np.allclose(first, second, rtol=0, atol=1e-11)
        index = {joint["name"]: k for k, joint in enumerate(document["joints"])}
        for actuator, reading in zip(document["actuators"], calibrated.readings[row], strict=True):
            assert values[index[actuator["joint"]]] == pytest.approx(
                actuator["zero"] + actuator["gain"] * reading, abs=1e-12
            )
        tool = frames[document["tool"]["joint"]] @ matrix(document["tool"]["placement"])
        base = np.linalg.inv(matrix(document["base"]["placement"]))
        seen = matrix(document["W"]) @ base @ tool @ matrix(document["T"])
        assert np.allclose(seen[:3, 3], calibrated.predicted.translation[row], rtol=0, atol=1e-10)
        assert np.allclose(seen[:3, :3], calibrated.predicted.rotation[row], rtol=0, atol=1e-10)


# Limits


def test_a_robot_at_the_edge_of_its_limits(start, robot_folder, robot, tmp_path):
    """The legs' limits enclose the drawn workspace exactly; the calibrated robot's, a little smaller, is exported."""
    loaded = robot("ups3_s")
    corners = grid(loaded.description.workspace, loaded.chain.tool_axes, [11] * 3)
    legs = inverse(loaded.chain, corners).q[:, loaded.chain.actuated]
    limits = f'lower="{legs.min() - 1e-9!r}" upper="{legs.max() + 1e-9!r}"'.replace("np.float64(", "").replace(")", "")
    urdf = robot_folder / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('lower="0.35" upper="0.65"', limits))
    run, _ = start(tmp_path / "store", "plan.poses=12", robot=robot_folder)
    exported = export_folder(run, tmp_path / "out")
    assert "98% of the drawing's, because of workspace: pose" in exported.note
    assert exported.note in (exported.path / "robot.toml").read_text()
    assert limits in (exported.path / "robot.urdf").read_text()
    toml = tomllib.loads((exported.path / "robot.toml").read_text())
    assert np.allclose(toml["workspace"]["rotation_deg"]["x"], [-19.6, 19.6])


# Refusals


def refused(answer, status: int, *said: str) -> None:
    assert answer.status == status, answer
    assert answer.out == ""
    assert "Traceback" not in answer.err
    for text in said:
        assert text in answer.err.splitlines()[-1]


@pytest.fixture
def exporting(cli, store, finished):
    """exporting(*arguments): export of the finished run."""
    settings = [part for setting in finished.settings for part in ("--set", setting)]
    return lambda *arguments: cli("export", "ups3_s", *settings, "--store", store, *arguments)


def test_what_is_there_already(exporting, tmp_path):
    there = tmp_path / "ups3_s_calibrated"
    there.mkdir()
    (there / "notes.txt").write_text("mine")
    refused(exporting("--format", "urdf"), 2, "ups3_s_calibrated", "--force")
    assert [p.name for p in there.iterdir()] == ["notes.txt"]
    assert exporting("--format", "urdf", "--force").status == 0
    assert (there / "notes.txt").read_text() == "mine"
    (there / "robot.urdf").write_text("old")
    assert exporting("--format", "urdf").status == 0  # made by export: replaced
    assert (there / "robot.urdf").read_text() != "old"
    (there / "robot.toml").write_text("# mine\n")
    refused(exporting("--format", "urdf"), 2, "not made by kincal export")
    assert (there / "robot.toml").read_text() == "# mine\n"
    refused(exporting("--format", "urdf", "--output", there / "notes.txt", "--force"), 2, "notes.txt", "a file")
    refused(exporting("--format", "urdf", "--output", ROBOTS / "ups3_s", "--force"), 2, "is read from")
    refused(exporting("--format", "urdf", "--output", "no/such/place"), 2, "no/such", "folder")
    assert not any(p.name.startswith(".kincal-export") for p in tmp_path.iterdir())


def test_a_document_that_is_there_already(exporting, tmp_path):
    file = tmp_path / "robot.json"
    file.write_text("{}")
    refused(exporting("--format", "json", "--output", file), 2, "robot.json", "--force")
    assert file.read_text() == "{}"
    assert exporting("--format", "json", "--output", file, "--force").status == 0
    before = file.read_bytes()
    assert exporting("--format", "json", "--output", file).status == 0  # made by export
    assert file.read_bytes() == before
    refused(exporting("--format", "json", "--output", tmp_path, "--force"), 2, "allowed is a new file")


@pytest.mark.parametrize("arguments", [(), ("--format", "sdf"), ("--format",)])
def test_a_bad_format(exporting, tmp_path, arguments):
    refused(exporting(*arguments), 2, "format")
    assert not (tmp_path / "ups3_s_calibrated").exists()


def test_a_failed_fit_is_not_exported(exporting, tmp_path):
    refused(exporting("--format", "urdf", "--set", "identify.max_iterations=1"), 1, "did not converge")
    refused(exporting("--format", "json", "--set", "identify.max_iterations=1", "--output", "x.json"), 1)
    assert {p.name for p in tmp_path.iterdir()} == {"store"}


@pytest.mark.parametrize("spoiled", ["urdf", "zero", "document"])
def test_an_export_that_predicts_otherwise_is_not_handed_out(start, store, finished, tmp_path, monkeypatch, spoiled):
    """A micrometre in what is written is noticed when it is read back."""
    run, _ = start(store, *finished.settings)
    if spoiled == "document":
        honest = json_document.calibration_document

        def document(*arguments):
            made = honest(*arguments)
            made["loops"][0]["frames"][0]["placement"]["xyz"][2] += 1e-6  # along the leg
            return made

        monkeypatch.setattr(json_document, "calibration_document", document)
        with pytest.raises(CalibrationError, match="differ"):
            export_document(run, tmp_path / "out")
    else:
        name = {"urdf": "calibrated_urdf", "zero": "exported_toml"}[spoiled]
        honest = getattr(written_folder, name)

        def spoil(*arguments):
            made = honest(*arguments)
            if spoiled == "zero":
                zero = repr(float(run.until("identify")[0].shipped.change[-18]))
                assert zero in made
                return made.replace(zero, repr(float(zero) + 1e-6))
            text = made.text.replace('xyz="0 0 1"', 'xyz="0 1e-6 1"', 1)
            assert text != made.text
            return type(made)(text, *list(vars(made).values())[1:])

        monkeypatch.setattr(written_folder, name, spoil)
        with pytest.raises(CalibrationError):
            export_folder(run, tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"store"}


def test_a_layout_of_toml_that_is_hard_to_edit(start, robot_folder, tmp_path):
    """Dotted keys, inline tables, tables out of order: the same robot comes out."""
    toml = robot_folder / "robot.toml"
    loops = ", ".join(
        f'{{ name = "l{k}", kind = "point", frames = ["leg{k}_tip", "platform_joint{k}"] }}' for k in (1, 2, 3)
    )
    toml.write_text(
        'plan.poses = 12\nname = "hard"\nurdf = "robot.urdf"\nbase_frame = "base"\ntool_frame = "platform"\n'
        'actuated = ["leg1_slide", "leg2_slide", "leg3_slide"]\n'
        f"loop = [{loops}]\n"
        "workspace.rotation_deg = { x = [-20, 20], y = [-20, 20], z = [-10, 10] }\n"
        "[actuator.leg1_slide]\ngain = 1\n[tolerance]\nposition_mm = 0.3\n[actuator.leg3_slide]\nzero = 0.0\n"
        "[measure]\nerrors.screw = false\n"
    )
    run, _ = start(tmp_path / "store", robot=toml)
    exported = export_folder(run, tmp_path / "out")
    before, after = (load_robot(str(f)).description for f in (toml, exported.path))
    same = before.model_dump(
        exclude={"actuator", "urdf", "prior", "pretrain", "transfer", "siblings", "correct", "evaluate", "measure"}
    )
    assert after.model_dump(include=set(same)) == same
    assert set(after.actuator) == set(after.actuated)
