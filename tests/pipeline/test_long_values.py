"""What a file says is shown in part: no line has more than 80 letters of it, and no control characters."""

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from kincal.urdf.errors import quoted, shortened

DOCS = Path(__file__).parents[2] / "docs"
MOST = 80
WORD = "Q" * 10_000
LINES = "QQQ\tQQ\n" * 2_000
BLANKS = "Q Q " * 2_500
ESCAPES = "\x1b[31mQ\x07\x85\u202e" * 2_000
VALUES = {"word": WORD, "mixed": LINES[:100] + BLANKS[:3000] + ESCAPES + LINES}
POSES = (DOCS / "samples" / "poses.csv").read_text()


def cautious(answer, status: int | None = 2) -> None:
    """The answer shows little of the value, on one line, printable."""
    assert status is None or answer.status == status, answer
    assert "Traceback" not in answer.err
    for line in (answer.err + answer.out).splitlines():
        assert line.count("Q") <= MOST, line
        assert line.isprintable(), repr(line)
    if answer.status == 2:
        assert len([line for line in answer.err.splitlines() if line.startswith("kincal: ")]) == 1


MORE = [*VALUES.values(), BLANKS, LINES, [WORD] * 50, {WORD: LINES}, 10**5000, "é\ud800" * 900, b"\x1b" * 999]


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    """One for all: what does not depend on the value is made once."""
    return tmp_path_factory.mktemp("long") / "store"


@pytest.fixture
def run(cli, store):
    """run(robot, until, *settings): `kincal run`."""

    def run(robot, until, *settings):
        return cli("run", robot, "--until", until, "--store", store, *(p for s in settings for p in ("--set", s)))

    return run


@pytest.mark.parametrize("value", MORE, ids=range(len(MORE)))
def test_helpers(value):
    for shown in (quoted(value), shortened(value) if not isinstance(value, int) else ""):
        assert len(shown) <= MOST
        assert shown.isprintable()


def test_short_values_are_shown_as_they_are():
    assert quoted("leg1_slide") == "'leg1_slide'"
    assert quoted(1.5) == "1.5"
    assert shortened("a column (UTC)") == "a column (UTC)"
    assert quoted("a" * 60).startswith("'aaaa")
    assert quoted("begin" + "a" * 60 + "end").endswith("end'")


def toml_text(value: str) -> str:
    """As TOML writes it."""
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in value) + '"'


TOML = [
    ('name = "ups3_s"', "name = {}"),
    ('name = "ups3_s"', 'name = "a"\n{} = 1'),
    ('urdf = "robot.urdf"', "urdf = {}"),
    ('base_frame = "base"', "base_frame = {}"),
    ('tool_frame = "platform"', "tool_frame = {}"),
    ('"leg3_slide"]', "{}]"),
    ('"leg3_slide"]', "{0}, {0}]"),
    ("seed = 0", "seed = {}"),
    ("seed = 0", "seed = [{0}, {0}]"),
    ("seed = 0", "seed = 0\n{0} = 1\n{0} = 2"),
    ("[sensor]", "[{}]"),
    ("[sensor]", "[actuator.{}]\nzero = 1.0\n[sensor]"),
    ("[sensor]", "[sensor]\n{} = 1"),
    ("poses = 150", "poses = {}"),
    ("poses = 150", "poses = {{{0} = {0}}}"),
    ('kind = "point"', "kind = {}"),
    ('"platform_joint3"]', "{}]"),
    ('source = "virtual"', "table = {}"),
    ('source = "virtual"', "table = {0}\nstreams = {0}"),
    ('source = "virtual"', 'table = "poses.csv"\nencoding = {}'),
    ('source = "virtual"', 'table = "poses.csv"\nseparator = {}'),
    ('source = "virtual"', 'table = "poses.csv"\n[measure.columns]\n{} = "x"\n[measure.more]'),
    ("x = [-20, 20]", "x = {}"),
]


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_robot_toml(run, robot_folder, value):
    file, text = robot_folder / "robot.toml", (robot_folder / "robot.toml").read_text()
    for old, new in TOML:
        assert old in text
        file.write_text(text.replace(old, new.format(toml_text(value)), 1), encoding="utf-8")
        cautious(run(file, "model"))


def xml(value: str) -> str:
    """Of an attribute: XML has no escape characters."""
    return "".join(c for c in value if c.isprintable() or c in "\t\n").replace("\n", "&#10;").replace("\t", "&#9;")


def each_with_a_long_value(run, drawing: Path, places: list[tuple[str, str]], value: str) -> None:
    """The robot beside the drawing, with the value in one place of it after the other."""
    text = drawing.read_text()
    for pattern, new in places:
        assert re.search(pattern, text), pattern
        drawing.write_text(re.sub(pattern, lambda _, new=new: new.format(xml(value)), text, count=1), encoding="utf-8")
        cautious(run(drawing.parent / "robot.toml", "model"), status=None)


URDF = [
    (r'<link name="base"', '<link name="{}"'),
    (r'<link name="leg1_rod"', '<link name="{}"'),
    (r'<joint name="leg3_slide"', '<joint name="{}"'),
    (r'type="prismatic"', 'type="{}"'),
    (r'parent link="[^"]*"', 'parent link="{}"'),
    (r'child link="[^"]*"', 'child link="{}"'),
    (r'xyz="[^"]*"', 'xyz="{}"'),
    (r'lower="[^"]*"', 'lower="{}"'),
    (r"<robot name", "<robot {}"),
]


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_drawings(run, robot_folder, value):
    file = robot_folder / "robot.urdf"
    each_with_a_long_value(run, file, URDF, value)
    for text in (f"<{'Q' * 9999}/>", f"<mujoco><{'Q' * 9999}/></mujoco>"):
        file.write_text(text)
        cautious(run(robot_folder / "robot.toml", "model"))


MJCF = [
    (r'default class="leg3"', 'default class="{}"'),
    (r'class="slide"', 'class="{}"'),
    (r'range="[^"]*"', 'range="{}"'),
    (r'body name="leg1_rod"', 'body name="{}"'),
    (r'quat="[^"]*"', 'quat="{}"'),
    (r'type="ball"', 'type="{}"'),
    (r'site1="[^"]*"', 'site1="{}"'),
    (r'<connect name="leg1"', '<connect name="{}"'),
    (r'angle="radian"', 'angle="{}"'),
    (r"<light ", "<{} "),
]


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_mjcf(run, tmp_path, value):
    folder = Path(shutil.copytree(Path(__file__).parents[1] / "data" / "ups3_mjcf", tmp_path / "robot"))
    each_with_a_long_value(run, folder / "robot.xml", MJCF, value)


def cell(value: str) -> str:
    return '"' + value + '"'


HEADER, FIRST, *_ = POSES.splitlines()
TABLES = [
    POSES.replace("leg1_slide", "{}", 1),  # a column's name
    POSES.replace("leg1_slide", "leg1_slide{}", 1),
    POSES.replace("pose,", "{},pose,", 1),
    POSES.replace(HEADER, HEADER + ",{}", 1).replace(FIRST, FIRST + ",1", 1),
    POSES.replace(HEADER, HEADER + ",{0}a,{0}b", 1),
    POSES.replace(HEADER, HEADER + ",{0},{0}", 1),
    POSES.replace("0.500005005", "{}", 1),  # a cell
    POSES.replace("\n0,", "\n{},", 1),
    "{}\n" + POSES,
    "{}",
    "{0},{0}\n{0},{0}\n",
    POSES.replace(FIRST, FIRST + ",{0},{0}", 1),
]


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables(run, tmp_path, value, suffix):
    file = tmp_path / f"poses{suffix}"
    setting = f"measure.table={file}"
    for text in TABLES:
        written = text.format(cell(value))
        if suffix == ".parquet":
            lines = [line.split(",") for line in text.format("{}").splitlines()]
            width = len(lines[0])
            rows = [[c.format(value) if c == "{}" else c for c in row] for row in lines[1:] if len(row) == width]
            names = [c.replace("{0}", "{}").format(value) for c in lines[0]]
            if len(set(names)) < len(names):
                continue
            frame = pd.DataFrame(rows, columns=names) if rows else pd.DataFrame(columns=names)
            frame.to_parquet(file)
        else:
            file.write_text(written, encoding="utf-8")
        cautious(run("ups3_s", "measure", setting), status=None)


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_streams(run, tmp_path, value):
    commands = shutil.copy(DOCS / "samples" / "commands.csv", tmp_path)
    logs = {
        "stream.csv": f"t,pose,{cell(value)},pitch\n0,0,0,0\n",
        "cells.csv": "t,roll,pitch\n" + f"{cell(value)},{cell(value)},0\n" * 5,
        "log.nmea": f"$PSXN,23,{value},0.1,0.2,0.3*00\n" * 3,
        "names.nmea": "$" + value + "\n" + "$PSXN,23,1,2,3,4*00\n" * 5,
    }
    table, commands = f"measure.table={DOCS / 'samples' / 'poses.csv'}", f"measure.commands={commands}"
    for name, text in logs.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        for other in (commands, table):
            cautious(run("ups3_s", "measure", f"measure.streams={tmp_path / name}", other))


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_bags(run, tmp_path, value):
    commands = shutil.copy(DOCS / "samples" / "commands.csv", tmp_path)
    settings = [f"measure.streams={tmp_path / 'bag'}", f"measure.commands={commands}"]
    name = "".join(f"\\u{ord(c):04x}" if not c.isalnum() else c for c in value)
    file = Path(shutil.copytree(DOCS / "samples" / "bag", tmp_path / "bag")) / "metadata.yaml"
    metadata = file.read_text()
    for old in re.findall(r"(?:name|type|storage_identifier|path)\w*: (\S+)", metadata):
        file.write_text(metadata.replace(old, f'"{name}"'))
        cautious(run("ups3_s", "measure", *settings, 'measure.log.topic="other"'))
    file.write_text(f'"{name}')
    cautious(run("ups3_s", "measure", *settings), None)  # a folder's files are read without it
