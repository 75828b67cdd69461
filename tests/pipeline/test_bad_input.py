"""Bad input is answered by one line on stderr and exit status 2; what was calculated before stays."""

import re
import shutil
from pathlib import Path

import pytest


def refused(answer, *said: str) -> None:
    """One line, which says each of these; nothing on stdout."""
    assert answer.status == 2, answer
    assert answer.out == ""
    lines = [line for line in answer.err.splitlines() if not re.match(r"^\S+ (\w+) +(running|ran|cached)\b", line)]
    assert len(lines) == 1, answer.err
    assert lines[0].startswith("kincal: ")
    assert "Traceback" not in answer.err
    for text in said:
        assert text in lines[0]


# robot.toml and robot.urdf


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("seed = 0", "seed = = 0", ["robot.toml", "not valid TOML", "line"]),
        ("seed = 0", "sead = 0", ["robot.toml", "sead", "unknown key", "'seed'"]),
        ("[sensor]", "[senzor]", ["robot.toml", "senzor", "unknown key", "'sensor'"]),
        ("orientation_deg = 0.0006", "orientation_rad = 1e-5", ["sensor.orientation_rad", "'orientation_deg'"]),
        ("position_mm = 0.3", "position_m = 0.0003", ["tolerance.position_m", "'position_mm'"]),
        ("poses = 150", 'poses = "many"', ["plan.poses", "'many'"]),
        ("poses = 150", "poses = 1.5", ["plan.poses", "1.5"]),
        ("poses = 150", "poses = 0", ["plan.poses", "0"]),
        ("orientation_deg = 0.0006", "orientation_deg = -1", ["sensor.orientation_deg", "-1"]),
        ("orientation_deg = 0.0006", "orientation_deg = nan", ["sensor.orientation_deg", "nan"]),
        ('kind = "point"', 'kind = "ball"', ["loop", "'ball'", "point"]),
        ("x = [-20, 20]", "x = [20, -20]", ["rotation_deg", "low < 0 < high"]),
        ("x = [-20, 20]", "x = [-89, 89]", ["workspace"]),
        ('source = "virtual"', 'source = "files"', ["measure", "table"]),
        ('urdf = "robot.urdf"', 'urdf = "missing.urdf"', ["urdf: ", "missing.urdf: can't be read"]),
        ('tool_frame = "platform"', 'tool_frame = "platfrom"', ["tool_frame", "'platfrom'", "'platform"]),
        ('base_frame = "base"', 'base_frame = "leg1_rod"', ["base_frame", "moves"]),
        ('"leg3_slide"]', '"leg3_slyde"]', ["actuated", "leg3_slyde", "'leg3_slide'"]),
        ('"leg3_slide"]', '"leg2_slide"]', ["leg2_slide", "twice"]),
        ('"leg2_slide", "leg3_slide"]', '"leg2_slide"]', ["3 degrees of freedom", "2 actuated"]),
        ('name = "ups3_s"', 'name = "<script>alert(1)</script>"', ["name"]),
        ('name = "ups3_s"', 'name = "../../etc"', ["name"]),
        ('"platform_joint3"]', '"leg3_rod"]', ["loop"]),
    ],
)  # fmt: skip
def test_robot_toml(cli, robot_folder, store, still_served, old, new, said):
    file = robot_folder / "robot.toml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    refused(cli("run", file, "--store", store), *said)
    still_served(store)


BOMB = '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {chr(98 + k)} "{10 * f"&{chr(97 + k)};"}">' for k in range(9)
)
LOOP = '<joint name="again" type="fixed"><parent link="leg1_tip"/><child link="platform"/></joint></robot>'


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda text: "", ["robot.urdf", "XML"]),
        (lambda text: text[:500], ["robot.urdf", "not well-formed"]),
        (lambda text: BOMB + "]><robot name='r'><link name='&j;'/></robot>", ["robot.urdf", "entities"]),
        (lambda text: text.replace("</robot>", LOOP), ["'platform'", "two parents", "[[loop]]"]),
        (lambda text: text.replace('xyz="0.3 0 0"', 'xyz="0.3 0"'), ["leg1_u1", "0.3 0"]),
        (lambda text: text.replace('xyz="0.3 0 0"', 'xyz="nan 0 0"'), ["leg1_u1", "nan"]),
        (lambda text: text.replace('lower="0.35"', 'lower="0.44"'), ["workspace", "leg", "limits"]),
        (lambda text: text.replace('type="prismatic"', 'type="floating"', 1), ["leg1_slide", "floating"]),
        (lambda text: text.replace('<link name="leg1_rod"/>', ""), ["leg1_rod", "does not exist"]),
        (lambda text: text.replace('"0 0 0.45"', '"0 0 9.45"'), ["workspace", "leg1_slide", "limits"]),
        (lambda text: "<html></html>", ["html", "<robot>"]),
    ],
    ids=["empty", "cut off", "bomb", "loop", "two numbers", "nan", "limits", "type", "no link", "far", "html"],
)
def test_robot_urdf(cli, robot_folder, store, still_served, change, said):
    file = robot_folder / "robot.urdf"
    file.write_text(change(file.read_text()))
    refused(cli("run", robot_folder, "--store", store), *said)
    still_served(store)


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("</worldbody>", "</wordlbody>", ["robot.xml", "not well-formed"]),
        ("<worldbody>", '<include file="/etc/passwd"/><worldbody>', ["robot.xml", "<include>"]),
        ('site1="leg1_tip"', 'site1="leg1_tpi"', ["'leg1'", "'leg1_tpi'", "'leg1_tip'"]),
        ('anchor="0 0 0"', 'anchor="0 0 0" active="false"', ["'leg2'", "not active"]),
        ('<connect name="leg1" site1="leg1_tip" site2="platform_joint1"/>', "", ["6 degrees of freedom", "3 actuated"]),
    ],
    ids=["malformed", "include", "no site", "inactive", "loop too few"],
)
def test_robot_mjcf(cli, tmp_path, old, new, said):
    folder = Path(shutil.copytree(Path(__file__).parents[1] / "data" / "ups3_mjcf", tmp_path / "robot"))
    text = (folder / "robot.xml").read_text()
    assert old in text
    (folder / "robot.xml").write_text(text.replace(old, new, 1))
    refused(cli("run", folder), *said)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x00\x01"])
@pytest.mark.parametrize("name", ["robot.toml", "robot.urdf"])
def test_binary_files(cli, robot_folder, name, content):
    (robot_folder / name).write_bytes(content)
    refused(cli("run", robot_folder), name)


# The measurement table


def changed(column: str, value, row: int = 4):
    def change(table):
        table = table.copy()
        table[column] = table[column].astype(object)
        table.loc[row, column] = value
        return table

    return change


def times(factor: float, *columns: str):
    return lambda table: table.assign(**{c: factor * table[c] for c in columns})


QUATERNION = ("qx", "qy", "qz", "qw")
TABLES = {
    "nan": (changed("qx", "nan"), ["qx", "row 5", "finite"]),
    "empty cell": (changed("qx", ""), ["qx", "row 5"]),
    "infinity": (changed("leg2_slide", "inf"), ["leg2_slide", "row 5"]),
    "text": (changed("leg2_slide", "long"), ["leg2_slide", "row 5", "long"]),
    "text pose": (changed("pose", "first"), ["pose", "row 5"]),
    "half a pose": (changed("pose", 4.5), ["pose", "row 5"]),
    "no joint": (lambda table: table.drop(columns="leg3_slide"), ["leg3_slide", "missing"]),
    "millimetres": (times(1000, "leg1_slide", "leg2_slide", "leg3_slide"), ["leg1_slide", "limits", "a column's unit"]),
    "beyond a limit": (changed("leg1_slide", 0.7), ["pose 4", "leg1_slide", "limits"]),
    "duplicate pose": (changed("pose", 3), ["pose 3", "twice"]),
    "short quaternion": (times(0.9, *QUATERNION), ["quaternion", "0.9"]),
    "zero quaternion": (times(0.0, *QUATERNION), ["quaternion", "0"]),
    "part of a quaternion": (lambda table: table.drop(columns="qz"), ["qz"]),
    "nothing measured": (lambda table: table.drop(columns=list(QUATERNION)), ["nothing was measured"]),
    "two poses": (lambda table: table.head(2), ["2 poses", "at least"]),
    "no pose": (lambda table: table.head(0), ["empty"]),
    "negative sigma": (lambda table: table.assign(orientation_std=-1.0), ["orientation_std", "greater than 0"]),
}


@pytest.mark.parametrize("change, said", TABLES.values(), ids=TABLES)
def test_measurement_table(cli, finished, store, still_served, tmp_path, change, said):
    file = tmp_path / "table.csv"
    change(finished.table).to_csv(file, index=False)
    settings = ("--set", "measure.source=files", "--set", f"measure.table={file}")
    refused(cli("run", "ups3_s", "--store", store, *settings), *said)
    still_served(store)
    refused(cli("evaluate", "ups3_s", "--store", store, "--set", "plan.poses=12", "--register", "--data", file), *said)


@pytest.mark.parametrize(
    "name, content, said",
    [
        ("table.csv", None, ["table.csv", "can't be read"]),
        ("table.parquet", None, ["table.parquet", "can't be read"]),
        ("table.csv", b"", ["table.csv", "empty"]),
        ("table.csv", b"\n\n\n", ["table.csv", "empty"]),
        ("table.csv", b"\x00\xff\xfe\x80" * 40, ["table.csv"]),
        ("table.csv", b'pose,leg1_slide\n0,"1\n', ["table.csv"]),
        ("table.csv", b"a,b\n1,2,3,4\n1\n", ["table.csv"]),
        ("table.parquet", b"", ["table.parquet"]),
        ("table.parquet", b"PAR1 is what this is not", ["table.parquet"]),
    ],
)
@pytest.mark.parametrize("command", ["run", "evaluate", "predict"])
def test_files_that_are_no_table(cli, store, still_served, tmp_path, name, content, said, command):
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    options = {
        "run": ("--set", "measure.source=files", "--set", f"measure.table={file}"),
        "evaluate": ("--set", "plan.poses=12", "--data", file),
        "predict": ("--set", "plan.poses=12", "--joints", file),
    }[command]
    field = ["measure.table: "] if command == "run" and content is None else []
    refused(cli(command, "ups3_s", "--store", store, *options), *field, *said)
    still_served(store)


def test_a_folder_is_no_table(cli, store, tmp_path):
    refused(cli("evaluate", "ups3_s", "--store", store, "--set", "plan.poses=12", "--data", tmp_path), str(tmp_path))


@pytest.mark.parametrize("value", ["nan", "500", "long", ""])
def test_joint_values_of_predict(cli, store, tmp_path, value):
    (tmp_path / "joints.csv").write_text(f"leg1_slide,leg2_slide,leg3_slide\n0.47,{value},0.47\n")
    answer = cli("predict", "ups3_s", "--store", store, "--set", "plan.poses=12", "--joints", "joints.csv")
    refused(answer, "joints.csv", "leg2_slide")


@pytest.mark.parametrize("map", ["nonsense =", "no_column = 'a'", "qx = { from = 'a', unit = 'inch' }"])
def test_column_maps(cli, finished, store, tmp_path, map):
    finished.table.to_csv(tmp_path / "table.csv", index=False)
    (tmp_path / "columns.toml").write_text(map)
    options = ("--store", store, "--set", "plan.poses=12", "--data", "table.csv", "--columns", "columns.toml")
    refused(cli("evaluate", "ups3_s", *options))


# The command line


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["run", "ups3_z"], ["ups3_z", "'ups3_s"]),
        (["run", "no/such/robot.toml"], ["no/such/robot.toml"]),
        (["run", ""], []),
        (["run"], ["robot"]),
        (["run", "ups3_s", "--until", "idenfity"], ["idenfity", "identify"]),
        (["run", "ups3_s", "--force-from", "idenfity"], ["idenfity", "identify"]),
        (["run", "ups3_s", "--force-from", "report", "--until", "plan"], ["--force-from report", "--until plan"]),
        (["run", "ups3_s", "--set", "plan.poses"], ["--set", "table.key=value"]),
        (["run", "ups3_s", "--set", "=3"], ["--set", "table.key=value"]),
        (["run", "ups3_s", "--set", "plan.pose=12"], ["plan.pose", "'poses'"]),
        (["run", "ups3_s", "--set", "plan.poses.more=12"], ["plan.poses"]),
        (["run", "ups3_s", "--set", "plan.poses=few"], ["--set", "few"]),
        (["run", "ups3_s", "--set", "seed=-1"], ["--set", "seed"]),
        (["run", "ups3_s", "--set", "..=1"], ["--set"]),
        (["run", "ups3_s", "--unti", "model"], ["--unti"]),
        (["run", "ups3_s", "more"], ["more"]),
        (["rum", "ups3_s"], ["rum"]),
        (["--no-such-option"], ["--no-such-option"]),
        (["compare", "ups3_s", "ups3_z", "--set", "plan.poses=12"], ["ups3_z"]),
        (["predict", "ups3_s", "--set", "plan.poses=12"], ["joints"]),
        (["evaluate", "ups3_s", "--set", "plan.poses=12"], ["data"]),
        (["predict", "ups3_s", "--set", "plan.poses=12", "--joints", "j.csv", "--method", "magic"], ["magic"]),
    ],
    ids=" ".join,
)
def test_command_line(cli, store, still_served, arguments, said):
    if arguments[0] in ("run", "predict", "evaluate", "compare"):
        arguments = [*arguments, "--store", store]
    refused(cli(*arguments), *said)
    still_served(store)


def test_a_real_process_says_the_same(kincal, store):
    """Of all that goes through `cli` in this process, once as a process of its own."""
    refused(kincal("run", "ups3_s", "--store", store, "--set", "plan.pose=12"), "plan.pose", "'poses'")
