"""robot.toml: what is refused and how, overrides, and how a robot is found."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.urdf.description import ROBOTS, RobotDescription, load_robot, read_columns, validate
from kincal.urdf.errors import InputError

UPS3 = (ROBOTS / "ups3_s" / "robot.toml").read_text()
TABLES = (
    (),
    ("workspace",),
    ("tolerance",),
    ("sensor",),
    ("split",),
    ("plan",),
    ("measure",),
    ("measure", "errors"),
    ("identify",),
    ("evaluate",),
    ("actuator", "leg1_slide"),
    ("measure", "columns", "x"),
)

REFUSALS = {
    "a misspelt key": ("position_mm = 0.3", "positoin_mm = 0.3", ["tolerance.positoin_mm", "'position_mm'"]),
    "a misspelt table": ("[tolerance]", "[tolerances]", ["tolerances", "'tolerance'"]),
    "a misspelt required key": ("tool_frame =", "tool_fram =", ["tool_fram", "'tool_frame'"]),
    "a wrong unit": ("rotation_deg = 0.03", "rotation_rad = 0.0005", ["tolerance.rotation_rad", "'rotation_deg'"]),
    "a missing key": ('base_frame = "base"\n', "", ["base_frame", "required"]),
    "text for a number": ("position_mm = 0.3", 'position_mm = "0.3"', ["tolerance.position_mm", "0.3", "number"]),
    "a number for text": ('name = "ups3_s"', "name = 3", ["name", "found 3"]),
    "not positive": ("position_mm = 0.3", "position_mm = 0", ["tolerance.position_mm", "greater than 0"]),
    "not finite": ("position_mm = 0.3", "position_mm = nan", ["tolerance.position_mm", "finite"]),
    "a range without 0": ("x = [-20, 20]", "x = [5, 20]", ["workspace.rotation_deg", "x = [5.0, 20.0]", "low < 0"]),
    "a range reversed": ("x = [-20, 20]", "x = [20, -20]", ["workspace.rotation_deg", "low < 0 < high"]),
    "a range of three": ("x = [-20, 20]", "x = [-20, 0, 20]", ["workspace.rotation_deg"]),
    "a range beyond the chart": ("y = [-20, 20]", "y = [-90, 90]", ["workspace", "rotation_deg.y", "85"]),
    "an axis that is none": ("x = [-20, 20]", "w = [-20, 20]", ["workspace.rotation_deg", "w"]),
    "no axes": ("rotation_deg = { x = [-20, 20], y = [-20, 20], z = [-10, 10] }", "", ["workspace", "no axis"]),
    "an unknown kind of loop": ('kind = "point"', 'kind = "ball"', ["loop.0.kind", "ball", "point", "frame"]),
    "two loops of one name": ('name = "leg2"', 'name = "leg1"', ["loop", "'leg1'", "twice"]),
    "an actuator twice": ('"leg2_slide",', '"leg1_slide",', ["actuated", "'leg1_slide'", "twice"]),
    "a setting for no actuator": (
        "[plan]",
        "[actuator.leg1_slid]\ngain = 1.0\n[plan]",
        ["actuator.leg1_slid", "'leg1_slide'"],
    ),
    "a gain of zero": ("[plan]", "[actuator.leg1_slide]\ngain = 0.0\n[plan]", ["actuator.leg1_slide.gain"]),
    "a column's unknown unit": (
        'source = "virtual"',
        'columns = { x = { from = "a", unit = "inch" } }',
        ["measure.columns.x.unit", "inch", "mm"],
    ),
    "an unknown channel": ('["tilt", "yaw"]', '["colour"]', ["measure.channels", "colour", "tilt"]),
    "orientation and tilt": ('["tilt", "yaw"]', '["orientation", "tilt"]', ["channels", "only one of them"]),
    "files without a table": ('source = "virtual"', 'source = "files"', ["measure", "table"]),
    "all poses held out": ("[plan]", "[split]\ntest = 1.0\n[plan]", ["split.test", "less than 1"]),
    "a negative seed": ("seed = 0", "seed = -1", ["seed", "-1"]),
    "a name that is a path": ('name = "ups3_s"', 'name = "../x"', ["name", "../x"]),
}  # fmt: skip


@pytest.mark.parametrize("old, new, named", REFUSALS.values(), ids=REFUSALS)
def test_description_is_refused(old, new, named, tmp_path):
    """One line that names the file, the field, what was found and what is allowed."""
    assert old in UPS3
    file = tmp_path / "robot.toml"
    file.write_text(UPS3.replace(old, new, 1))
    with pytest.raises(InputError) as refusal:
        load_robot(str(file))
    message = str(refusal.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    for words in named:
        assert words in message.removeprefix(str(file)), f"{words!r} is not in {message!r}"


@pytest.mark.parametrize(
    "content, words",
    [
        (b"name = ", "not valid TOML"),
        (b'name = "a"\nname = "b"\n', "not valid TOML"),
        (b'name = "\xff"\n', "not UTF-8"),
        (b"a = " + b"[" * 20000 + b"]" * 20000, "TOML|deeply"),
    ],
)
def test_malformed_toml_is_refused(content, words, tmp_path):
    file = tmp_path / "robot.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=words) as refusal:
        load_robot(str(file))
    assert str(file) in str(refusal.value)


@given(table=st.sampled_from(TABLES), key=st.text("abcdefghijklmnopqrstuvwxyz_", min_size=1, max_size=12))
def test_any_unknown_key_at_any_level_is_refused_by_name(table, key):
    """Against the file itself: only a key that is written nowhere in the model may fail here."""
    content = tomllib.loads(UPS3)
    at = content
    for name in table:
        at = at.setdefault(name, {})
    if table[-1:] == ("x",):
        at["from"] = "a"
    key = f"zz_{key}"  # no legal key begins so
    at[key] = 1
    with pytest.raises(InputError) as refusal:
        validate(RobotDescription, content, "robot.toml")
    assert str(refusal.value).startswith(f"robot.toml: {'.'.join((*table, key))}: unknown key; ")


def test_every_shipped_robot_is_valid():
    """Each folder under urdf/robots, by name, by folder and by file: one and the same robot."""
    names = sorted(file.parent.name for file in ROBOTS.glob("*/robot.toml"))
    assert {"ups3_s", "ups3_s_printed", "jugglebot", "ur10"} <= set(names)
    for name in names:
        by_name = load_robot(name)
        assert by_name.description.name == name
        assert by_name.description.urdf.is_file()
        assert load_robot(str(ROBOTS / name)) == by_name
        assert load_robot(str(ROBOTS / name / "robot.toml")) == by_name


def test_an_unknown_robot_is_refused_with_the_nearest_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"'juglebot'.*did you mean 'jugglebot'"):
        load_robot("juglebot")
    with pytest.raises(InputError, match="absent"):
        load_robot(str(tmp_path / "absent" / "robot.toml"))


def test_defaults_are_those_of_the_design(tmp_path):
    """Only name, urdf, base_frame, tool_frame, actuated, workspace and measure are required."""
    file = tmp_path / "robot.toml"
    file.write_text(
        'name = "least"\nurdf = "r.urdf"\nbase_frame = "b"\ntool_frame = "t"\nactuated = ["j"]\n'
        "[workspace]\nrotation_deg = { z = [-10, 10] }\n[measure]\n"
    )
    found = load_robot(str(file)).description
    assert (found.seed, found.split.test, found.workspace.max_condition) == (0, 0.2, 100)
    assert (found.tolerance.position_mm, found.tolerance.rotation_deg, found.tolerance.actuator_gain) == (
        0.3,
        0.03,
        1e-3,
    )
    assert found.measure.virtual
    assert found.urdf == tmp_path / "r.urdf"


def test_overrides_replace_one_value():
    found = load_robot(
        "ups3_s", ["plan.poses=10", "measure.errors.elastic=false", "seed = 7", "name=other"]
    ).description
    assert found.plan.poses == 10
    assert found.measure.errors.elastic is False
    assert found.seed == 7
    assert found.name == "other"  # a bare word is a string
    assert found.tolerance == load_robot("ups3_s").description.tolerance


def test_overrides_take_tables_and_lists():
    found = load_robot(
        "ups3_s", ['measure.channels=["tilt", "yaw"]', "workspace.rotation_deg={x=[-1,1],y=[-2,2],z=[-3,3]}"]
    )
    assert found.description.measure.channels == ("tilt", "yaw")
    assert found.description.workspace.rotation_deg["z"] == (-3, 3)


@pytest.mark.parametrize(
    "override, named",
    [
        ("plan.posses=10", ["--set plan.posses=10", "unknown key", "'poses'"]),
        ("plan.poses=ten", ["--set plan.poses=ten", "plan.poses", "ten"]),
        ("plan.poses=0", ["--set plan.poses=0", "greater than or equal to 1"]),
        ("plan", ["--set plan", "table.key=value"]),
        ("=3", ["--set =3", "table.key=value"]),
        ("seed.deep=1", ["--set seed.deep=1", "seed", "not a table"]),
        ("actuated.first=1", ["--set actuated.first=1"]),
        ("plan..poses=3", ["--set plan..poses=3"]),
        ("plan.poses=" + "9" * 5000, ["plan.poses", "999"]),
        ("plann.poses=3", ["--set plann.poses=3", "unknown key", "'plan'"]),
        ("measure.error.elastic=false", ["--set measure.error.elastic=false", "'errors'"]),
    ],
)
def test_bad_overrides_are_refused_by_their_own_text(override, named):
    with pytest.raises(InputError) as refusal:
        load_robot("ups3_s", [override])
    for words in named:
        assert words in str(refusal.value)


def test_paths_are_relative_to_the_file_and_overridden_ones_to_the_current_folder(tmp_path, monkeypatch):
    folder, elsewhere = tmp_path / "robot", tmp_path / "elsewhere"
    shutil.copytree(ROBOTS / "ups3_s", folder)
    elsewhere.mkdir()
    file = folder / "robot.toml"
    file.write_text(file.read_text().replace('source = "virtual"', 'table = "poses.csv"'))
    monkeypatch.chdir(elsewhere)
    assert load_robot(str(file)).description.measure.table == folder / "poses.csv"
    changed = load_robot(str(file), ["measure.table=poses.csv"]).description
    assert changed.measure.table == elsewhere / "poses.csv"
    assert changed.urdf == folder / "robot.urdf"
    relative = load_robot("../robot/robot.toml").description.urdf
    assert relative.resolve() == (folder / "robot.urdf").resolve()
    assert Path(relative).is_absolute()


def test_a_column_map_from_a_file_of_its_own(tmp_path):
    file = tmp_path / "columns.toml"
    file.write_text('x = { from = "meas_x", unit = "mm" }\nqx = "ori_x"\n')
    found = read_columns(file)
    assert (found["x"].source, found["x"].unit) == ("meas_x", "mm")
    assert (found["qx"].source, found["qx"].unit) == ("ori_x", "1")
    file.write_text('[columns]\nx = { from = "meas_x", unti = "mm" }\n')
    with pytest.raises(InputError, match=r"columns.x.unti.*'unit'"):
        read_columns(file)


def test_a_table_that_is_set_is_what_is_measured():
    """A setting goes over robot.toml, in both directions."""
    assert not load_robot("ups3_s", ["measure.table=poses.csv"]).description.measure.virtual
    assert load_robot("ups3_s", []).description.measure.virtual


def test_a_virtual_robot_with_measurements_is_refused(edited):
    """In robot.toml and in settings; a setting that asks for a virtual robot alone goes over robot.toml's table."""
    both = 'source = "virtual"\ntable = "poses.csv"'
    file = edited(toml=[('source = "virtual" # a robot with known errors measures itself', both)])
    with pytest.raises(InputError, match=r'source = "virtual" and table = "poses.csv".*Delete source'):
        load_robot(str(file))
    assert load_robot(str(file), ['measure.source="virtual"']).description.measure.table is None
    assert not load_robot(str(file), ["measure.table=other.csv"]).description.measure.virtual
    with pytest.raises(InputError, match=r'source = "virtual" and commands'):
        load_robot("ups3_s", ['measure.source="virtual"', "measure.commands=log.csv", "measure.streams=s.csv"])
