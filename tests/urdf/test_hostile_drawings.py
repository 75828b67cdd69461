"""Drawings and robot.toml by somebody who means harm: one InputError each, soon, and with little memory."""

import os
import time

import pytest

from kincal.urdf.closed_chain import load_drawing
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError, one_line
from kincal.urdf.input_files import MAX_KEY, parse_toml, read_text

LAUGHS = "".join(f'<!ENTITY l{k} "{10 * f"&l{k - 1};"}">' for k in range(1, 12))
PROLOGUES = {
    "a billion laughs": f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>',
    "quadratic blowup": f'<!DOCTYPE r [<!ENTITY a "{"a" * 100_000}">]>',
    "an external entity": '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    "an external parameter entity": '<!DOCTYPE r [<!ENTITY % a SYSTEM "file:///dev/zero"> %a;]>',
    "an external document type": '<!DOCTYPE r SYSTEM "http://localhost:9/r.dtd">',
}
URDF = '<robot name="r"><link name="base"/>{}</robot>'
MJCF = '<mujoco>{}<worldbody><body name="b"><joint name="j"/></body></worldbody></mujoco>'
LINKS = "".join(f'<link name="l{k}"/>' for k in range(50_000))
CLASSES = "".join(f'<default class="c{k}">' for k in range(1500)) + "</default>" * 1500
REFUSED = {
    "links without joints": (URDF.format(LINKS), "50001 links; allowed are 501"),
    "elements in elements": (URDF.format("<a>" * 100_000 + "</a>" * 100_000), None),
    "attributes": (URDF.format("<link " + " ".join(f'a{k}="1"' for k in range(20_000)) + "/>"), "link without 'name'"),
    "bodies in bodies": (MJCF.format("").replace("<joint", "<body>" * 9000 + "</body>" * 9000 + "<joint"), "2000"),
    "classes in classes": (MJCF.format(f"<default>{CLASSES}</default>"), "allowed are 100"),
    "equalities": (MJCF.format("<equality>" + "<connect/>" * 20_000 + "</equality>"), "allowed are 2000"),
    "sites": (MJCF.format("").replace("<joint", "<site/>" * 20_000 + "<joint"), "allowed are 2000"),
    "a direction beyond all squares": (MJCF.format("").replace("<joint", '<joint axis="1e308 1e308 0"'), "finite"),
    "a number of Python's": (MJCF.format("").replace("<joint", '<joint axis="1_0 1 0"'), "finite"),
}  # fmt: skip


def soon(call):
    """What is raised, if anything; within 3 s of computing."""
    began, said = time.process_time(), None
    try:
        call()
    except InputError as error:
        said = str(error)
    assert time.process_time() - began < 3
    assert said is None or len(said) < 1100
    return said


@pytest.mark.parametrize("prologue", PROLOGUES.values(), ids=PROLOGUES)
@pytest.mark.parametrize("body", [URDF, MJCF], ids=["URDF", "MJCF"])
def test_entities_are_not_expanded(prologue, body, tmp_path):
    text = prologue + body.format("").replace("name=", 'title="&a;" name=' if "ENTITY a" in prologue else "name=", 1)
    assert "document types are not allowed" in soon(lambda: load_drawing(text, tmp_path / "robot.urdf"))


@pytest.mark.parametrize("text, said", REFUSED.values(), ids=REFUSED)
def test_absurd_drawings(text, said, tmp_path):
    found = soon(lambda: load_drawing(text, tmp_path / "robot.urdf"))
    assert said is None or said in found


def test_meshes_are_not_opened(edited):
    """Who reads a pipe waits for a writer; a path that leaves the folder is no path at all."""
    robot = edited(
        urdf=[
            (
                '<link name="base"/>',
                '<link name="base"><visual><geometry><mesh filename="{}"/></geometry></visual></link>',
            )
        ]
    )
    pipe = robot.parent / "pipe.dae"
    os.mkfifo(pipe)
    for name in ("pipe.dae", str(pipe), f"file://{pipe}", "package://../../etc/passwd", "/dev/zero"):
        text = (robot.parent / "robot.urdf").read_text().replace("{}", name)
        assert soon(lambda text=text: load_drawing(text, robot.parent / "robot.urdf")) is None


def test_what_the_parser_below_prints_is_the_message(edited, capfd):
    robot = edited(urdf=[('effort="10000" velocity="10"', 'effort="much" velocity="10"')])
    described = load_robot(str(robot)).description
    with pytest.raises(InputError, match=r"robot\.urdf: .*effort value \(much\) is not a valid float"):
        load_drawing(read_text(described.urdf), described.urdf)
    assert capfd.readouterr() == ("", "")


# Files that are none


@pytest.fixture
def no_files(tmp_path):
    """{what: path}"""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "large").touch()
    os.truncate(tmp_path / "large", 1 << 40)
    names = {"pipe": "pipe or a device", "folder": "folder", "loop": "can't be read", "large": "1099511627776 bytes"}
    others = {"/dev/zero": "pipe or a device", "/dev/stdin": "", "x" * 300: "can't be read", "a\0b": "can't be read"}
    return {str(tmp_path / name): said for name, said in names.items()} | others


def test_a_drawing_is_a_plain_file(edited, no_files):
    for name, said in no_files.items():
        text = edited().read_text().replace('"robot.urdf"', '"' + name.replace("\0", "\\u0000") + '"')
        robot = edited()
        robot.write_text(text)
        described = load_robot(str(robot)).description
        assert said in soon(lambda described=described: read_text(described.urdf))


def test_a_robot_toml_is_a_plain_file(no_files):
    for name in no_files:
        assert soon(lambda name=name: load_robot(name)) is not None


# robot.toml

HOSTILE_TOML = {
    "arrays in arrays": "a = " + "[" * 100_000,
    "tables in tables": "a = " + "{a = " * 100_000,
    "a key of many parts": "a." * 100_000 + "a = 1",
    "a quoted key of many parts": '"a" . ' * 100_000 + "a = 1",
    "tables of many parts": "[" + "a." * 100_000 + "a]",
    "a number of many digits": "seed = " + "9" * 100_000,
    "a number of many hexadecimal digits": "seed = 0x" + "f" * 100_000,
    "one word": "A" * 900_000,
    "quotes": '"' * 900_001,
    "too long": "#" * (1 << 20) + "\n",
}


@pytest.mark.parametrize("text", HOSTILE_TOML.values(), ids=HOSTILE_TOML)
def test_hostile_toml(edited, text):
    robot = edited()
    robot.write_text(text + "\n" + robot.read_text())
    assert "robot.toml" in soon(lambda: load_robot(str(robot)))


def test_a_key_may_have_parts():
    assert parse_toml("a." * (MAX_KEY - 2) + "b = 1")
    assert parse_toml("# " + "." * 500 + "\na = '" + "." * 500 + "'") == {"a": "." * 500}


@pytest.mark.parametrize(
    "text", ["a." * 1000 + "a=1", "seed=" + "[" * 50_000, "a=\n" + "a." * 30_000 + "a=1", "x\udce9=1"]
)
def test_hostile_overrides(text):
    assert soon(lambda: load_robot("ups3_s", [text])).startswith("--set")


def test_an_override_is_named_where_the_whole_table_is_wrong():
    with pytest.raises(InputError, match=r"robot\.toml with --set workspace\.rotation_deg=.*: workspace: .*allowed"):
        load_robot("ups3_s", ["workspace.rotation_deg={x=[-1, 1e9]}"])


def test_messages_are_one_line():
    """Whatever stands in a file: a terminal shows it, and obeys none of it."""
    said = str(InputError("a.csv: column '\x1b[2J\u202e\r\n\0'\u2028 x" + "A" * 10**7 + " allowed is b"))
    assert said.isprintable()
    assert len(said) < 1100
    assert said.startswith("a.csv: column '?[2J?")
    assert said.endswith("allowed is b")
    assert one_line("short, and as it is") == "short, and as it is"


def test_limits_that_are_the_wrong_way_round(edited, checked):
    old = '<limit lower="0.35" upper="0.65"'
    for new in ('<limit lower="0.65" upper="0.35"', '<limit lower="0.35"'):  # what is missing is 0
        with pytest.raises(InputError, match=r"robot\.urdf: joint 'leg1_slide': its limits are .*lower one first"):
            checked(edited(urdf=[(old, new)]))
