"""`kincal columns`: what is recognised in a table, and the column map that reads it."""

import json
import tomllib

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.column_proposals import proposals
from kincal.identification.measurement_table import UNITS, noted_table
from kincal.pipeline.interface.columns import map_as_toml, recognise
from kincal.urdf.description import Measure, load_robot, read_columns
from tests.identification.exports import motive
from tests.identification.test_exports import body

MEASURED = ("x", "y", "z", "qx", "qy", "qz", "qw")


def poses(robot: str, n: int = 5) -> pd.DataFrame:
    random = np.random.default_rng(6)
    quaternion = random.normal(size=(n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    table = pd.DataFrame({joint: random.normal(size=n) for joint in load_robot(robot).description.actuated})
    table[["x", "y", "z"]] = random.normal(size=(n, 3))
    table[["qx", "qy", "qz", "qw"]] = quaternion
    return table


def test_a_table_on_one_screen(cli, tmp_path):
    table = poses("ups3_s").assign(temperature=20.5, remark="fine")
    table.loc[2, ["x", "y", "z"]] = np.nan
    file = tmp_path / "table.csv"
    text = table.to_csv(index=False, sep=";", decimal=",", lineterminator="\n")
    file.write_text("made by a tracker\n# two bodies\n" + text, encoding="utf-16")
    answer = cli("columns", file, "ups3_s")
    assert answer.status == 0, answer.err
    for line in ("encoding: utf-16", "separator: semicolon", "decimal sign: ,", "names in line: 3, 2 lines above"):
        assert line in answer.out
    rows = {line.split()[0]: line.split() for line in answer.out.splitlines() if line}
    assert rows["leg1_slide"][1:3] == ["leg1_slide", "joint"]
    low, high = table["x"].min(), table["x"].max()
    assert rows["x"] == ["x", "x", "position", "m", f"{low:.6g}", f"{high:.6g}", "1"]
    assert rows["temperature"][1:] == ["-", "not", "used", "-", "20.5", "20.5", "0"]
    assert rows["remark"][-3:] == ["text", "text", "0"]
    document = json.loads(cli("columns", file, "ups3_s", "--json").out)
    assert document["schema"] == "kincal-columns-1"
    assert [c["name"] for c in document["columns"]] == list(table)


@pytest.mark.parametrize("robot", ["ups3_s", "gough_stewart", "ur10"])
def test_the_map_reads_the_table(robot, cli, tmp_path):
    """Columns with other names and units: the map that is written gives the plain table."""
    plain, file, output = poses(robot), tmp_path / "table.csv", tmp_path / "map.toml"
    joints = load_robot(robot).description.actuated
    foreign = plain.assign(**{axis: 1000 * plain[axis] for axis in "xyz"})
    names = {axis: f"Position {axis.upper()} [mm]" for axis in "xyz"} | {f"q{axis}": f"Quat_{axis}" for axis in "xyzw"}
    names |= {joint: joint.replace("_", " ").title() for joint in joints}
    foreign.rename(columns=names).to_csv(file, index=False)
    assert "Proposed: " in cli("columns", file, robot).out
    printed = cli("columns", file, robot, "--write").out
    assert cli("columns", file, robot, "--output", output).status == 0
    assert output.read_text() == printed
    assert cli("columns", file, robot, "--output", output).status == 2
    assert cli("columns", file, robot, "--output", output, "--force").status == 0
    columns = read_columns(output)
    assert columns["x"].unit == "mm"
    table, notes = noted_table(file, joints, Measure(table=file, columns=columns))
    pd.testing.assert_frame_equal(table[list(plain)], plain, rtol=1e-12)
    assert notes == ()


@given(
    unit=st.sampled_from(["", " [mm]", "(deg)", "_mm", " [RAD]", " (°)"]),
    name=st.sampled_from(["x", "qw", "yaw", "leg1_slide", "Hinge", "position_std"]),
    case=st.sampled_from([str.upper, str.title, str]),
)
def test_a_name_with_its_unit(unit, name, case):
    wanted = ["x", "qw", "yaw", "leg1_slide", "Hinge", "position_std"]
    column = proposals([case(name) + unit, "other"], wanted)[name]
    assert column.source == case(name) + unit
    assert (
        UNITS[column.unit] == {"": 1, "m": 1e-3, "d": np.pi / 180, "R": 1, "°": np.pi / 180}[unit.strip("[(_ ])")[:1]]
    )


def test_two_columns_for_one_name_are_no_proposal():
    assert proposals(["tx", "pos_x", "ty"], ["x", "y", "z"]).keys() == {"y"}
    assert proposals(["mm", "[mm]", "", "  "], ["x"]) == {}


def test_missing_joints_and_unused_columns_are_comments(tmp_path):
    file = tmp_path / "table.csv"
    poses("ups3_s").drop(columns="leg2_slide").assign(**{"a\tb": 1.0}).to_csv(file, index=False)
    text = map_as_toml(recognise(file, "ups3_s"))
    assert '# leg2_slide = ""' in text
    assert r"# not used: a\tb" in text
    assert set(tomllib.loads(text)["measure"]["columns"]) == {"leg1_slide", "leg3_slide", *MEASURED}


def test_an_export(cli, tmp_path):
    file = tmp_path / "take.csv"
    file.write_text(motive({"arm": body(4, 1), "platform": body(4, 2, gaps=(1,))}))
    refused = cli("columns", file)
    assert refused.status == 2
    assert "set measure.body; allowed are arm, platform" in refused.err
    shown = cli("columns", file, "--set", "measure.body=platform")
    assert "read rigid body 'platform' in 4 frames, 1 of them without it" in shown.out
    assert "Set measure.joints" in cli("columns", file, "ups3_s", "--set", "measure.body=platform").out
    assert "allowed are settings of measure" in cli("columns", file, "--set", "plan.poses=3").err


def test_templates(tmp_path):
    """By the name of an instrument or a program; other settings stay beside it."""
    plain, file = poses("ur10"), tmp_path / "table.csv"
    joints = load_robot("ur10").description.actuated
    ndi = plain.assign(**{axis: 1000 * plain[axis] for axis in "xyz"})
    names = {axis: f"T{axis}" for axis in "xyz"} | {"qx": "Qx", "qy": "Qy", "qz": "Qz", "qw": "Q0"}
    ndi.rename(columns=names).to_csv(file, index=False)
    measure = Measure.model_validate({"table": file, "columns": "ndi"})
    pd.testing.assert_frame_equal(noted_table(file, joints, measure)[0][list(plain)], plain, rtol=1e-12)
    with pytest.raises(ValueError, match="'sextant': no such template; allowed are motive, qualisys, ndi"):
        Measure.model_validate({"table": file, "columns": "sextant"})
