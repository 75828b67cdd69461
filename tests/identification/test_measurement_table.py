"""Measurement tables: what is read, in which units, and what is refused by file, column and row."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from kincal.identification.joint_limits import check_readings
from kincal.identification.measurement_table import read_table
from kincal.identification.measurements import quaternions, to_measurements, to_table
from kincal.urdf.description import Measure, Sensor
from kincal.urdf.errors import InputError

JOINTS = ("leg1_slide", "leg2_slide", "leg3_slide")
HEADER = "pose,leg1_slide,leg2_slide,leg3_slide,qx,qy,qz,qw"
ROWS = ("0,0.45,0.46,0.47,0,0,0,1", "1,0.44,0.46,0.48,0.6,0,0,0.8", "2,0.45,0.47,0.46,0,0.6,0,-0.8")
GOOD = "\n".join((HEADER, *ROWS)) + "\n"


def measure(**settings) -> Measure:
    return Measure.model_validate({"table": "t.csv", **settings})


@pytest.fixture
def read(tmp_path):
    """read(text or bytes, **settings of [measure]): the table."""

    def reading(content: str | bytes, name: str = "poses.csv", **settings) -> pd.DataFrame:
        file = tmp_path / name
        file.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_table(file, JOINTS, measure(**settings))

    return reading


def test_a_table_as_the_design_has_it(read):
    table = read(GOOD)
    assert list(table["pose"]) == [0, 1, 2]
    np.testing.assert_array_equal(table["leg2_slide"], [0.46, 0.46, 0.47])
    found = to_measurements(table, JOINTS, Sensor(orientation_deg=0.5))
    assert found.channels == ("orientation",)
    assert len(found) == 3
    expected = Rotation.from_quat([[0, 0, 0, 1], [0.6, 0, 0, 0.8], [0, 0.6, 0, -0.8]]).as_matrix()
    np.testing.assert_allclose(found.values["orientation"], expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.std["orientation"], np.deg2rad(0.5))


def test_every_channel_and_its_sigma(read):
    text = (
        "pose,leg1_slide,leg2_slide,leg3_slide,x,y,z,roll,pitch,yaw,position_std,tilt_std,yaw_std,comment\n"
        "5,0.45,0.46,0.47,1,2,3,0.1,0.2,0.3,0.01,0.02,0.03,fine\n"
    )
    found = to_measurements(read(text), JOINTS, Sensor())
    assert found.channels == ("tilt", "yaw", "position")
    np.testing.assert_array_equal(found.pose, [5])
    np.testing.assert_array_equal(found.values["position"], [[1, 2, 3]])
    np.testing.assert_array_equal(found.values["tilt"], [[0.1, 0.2]])
    np.testing.assert_array_equal(found.values["yaw"], [0.3])
    assert (found.std["position"][0], found.std["tilt"][0], found.std["yaw"][0]) == (0.01, 0.02, 0.03)


def test_poses_are_numbered_where_the_table_does_not(read):
    text = "\n".join(line.partition(",")[2] for line in GOOD.splitlines()) + "\n"
    assert list(read(text)["pose"]) == [0, 1, 2]


def test_parquet_is_the_same_table(read, tmp_path):
    table = read(GOOD)
    file = tmp_path / "poses.parquet"
    table.to_parquet(file)
    pd.testing.assert_frame_equal(read_table(file, JOINTS, measure()), table)


def test_a_foreign_table_by_map_units_separator_and_decimal_comma(read):
    """A German spreadsheet in millimetres and degrees."""
    text = "Bein 1;leg2_slide;leg3_slide;px;py;pz;ax;ay;az\n450,5;0,46;0,47;1000;-2000,5;3;10;20;-30\n"
    columns = {
        "leg1_slide": {"from": "Bein 1", "unit": "mm"},
        "x": {"from": "px", "unit": "mm"},
        "y": {"from": "py", "unit": "mm"},
        "z": {"from": "pz", "unit": "m"},
        "rx": {"from": "ax", "unit": "deg"},
        "ry": {"from": "ay", "unit": "deg"},
        "rz": {"from": "az", "unit": "deg"},
    }
    table = read(text, columns=columns, separator=";", decimal=",")
    found = to_measurements(table, JOINTS, Sensor())
    np.testing.assert_allclose(found.readings, [[0.4505, 0.46, 0.47]])
    np.testing.assert_allclose(found.values["position"], [[1.0, -2.0005, 3.0]])
    expected = Rotation.from_euler("XYZ", [10, 20, -30], degrees=True).as_matrix()
    np.testing.assert_allclose(found.values["orientation"][0], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("row, refused", [("", True), ("\n-,in,in,in", False), ("\n-,in,in,-", True)])
def test_a_unit_for_a_part_of_a_group_is_refused(row, refused):
    """Nobody measures x in inches and y in metres; a unit that is written out is taken by its word."""
    content = f"j,x,y,z{row}\n1,100,200,300\n"
    columns = {"x": {"from": "x", "unit": "in"}}
    if refused:
        with pytest.raises(
            InputError, match=r"x has the unit 'in', but [yz] has no unit: set that of each in measure\.columns"
        ):
            _read_text(content, ("j",), columns=columns)
    else:
        np.testing.assert_allclose(_read_text(content, ("j",), columns=columns)[["x", "y", "z"]], [[2.54, 5.08, 7.62]])
    columns |= {"y": {"from": "y", "unit": "m"}, "z": {"from": "z", "unit": "1"}}
    np.testing.assert_allclose(
        _read_text("j,x,y,z\n1,1,1,1\n", ("j",), columns=columns)[["x", "y", "z"]], [[0.0254, 1, 1]]
    )


def test_units_of_joints():
    """A revolution is 2 pi, unless the actuator's own unit is meant."""
    content = "j,x,y,z\n2,0,0,0\n"
    for unit, value in (("rev", 4 * np.pi), ("deg", np.deg2rad(2)), ("1", 2.0), ("rad", 2.0)):
        table = _read_text(content, ("j",), columns={"j": {"from": "j", "unit": unit}})
        assert table["j"][0] == pytest.approx(value)


def _read_text(content: str, joints, **settings) -> pd.DataFrame:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "t.csv"
        file.write_text(content)
        return read_table(file, joints, measure(**settings))


REFUSALS = {
    "an empty file": ("", ["empty"]),
    "a header only": (HEADER + "\n", ["empty", "at least one row"]),
    "not UTF-8": (GOOD.encode() + b"3,\xff\xfe,1,1,0,0,0,1\n", ["leg1_slide", "row 4", "finite"]),
    "NaN": (GOOD.replace("0.46", "nan", 1), ["'leg2_slide'", "row 1", "nan", "finite"]),
    "infinity": (GOOD.replace("0.48", "inf", 1), ["'leg3_slide'", "row 2", "inf", "finite"]),
    "nothing between commas": (GOOD.replace("0.48", "", 1), ["'leg3_slide'", "row 2", "finite"]),
    "text": (GOOD.replace("0.48", "long", 1), ["'leg3_slide'", "row 2", "'long'", "finite"]),
    "a decimal comma": (GOOD.replace("0.48", '"0,48"', 1), ["'leg3_slide'", "row 2", "'0,48'"]),
    "true": (GOOD.replace("0.45,", "True,").replace("0.44,", "False,"), ["'leg1_slide'", "row 1"]),
    "no joint column": (GOOD.replace("leg2_slide", "leg_2"), ["'leg2_slide'", "missing", "leg_2"]),
    "a pose twice": (GOOD.replace("2,0.45", "1,0.45", 1), ["pose 1", "twice", "row 3"]),
    "half a pose": (GOOD.replace("2,0.45", "2.5,0.45", 1), ["'pose'", "row 3", "2.5", "whole"]),
    "a quaternion of length 0.9": (GOOD.replace("0,0,0,1", "0,0,0,0.9"), ["row 1", "quaternion", "0.9"]),
    "a quaternion of length 0": (GOOD.replace("0,0,0,1", "0,0,0,0"), ["row 1", "quaternion", "0"]),
    "part of a quaternion": (GOOD.replace("qw", "w"), ["qx, qy, qz", "qw"]),
    "part of a position": (GOOD.replace("qx,qy,qz,qw", "x,y,b,c"), ["x, y", "z"]),
    "roll alone": (GOOD.replace("qx,qy,qz,qw", "roll,a,b,c"), ["roll", "pitch"]),
    "nothing measured": (GOOD.replace("qx,qy,qz,qw", "a,b,c,d"), ["nothing was measured", "qx"]),
    "a sigma of zero": (
        GOOD.replace("qw", "qw,orientation_std").replace("0,0,0,1", "0,0,0,1,0").replace("0.8\n", "0.8,1e-5\n"),
        ["'orientation_std'", "row 1", "greater than 0"],
    ),
    "a negative sigma": (
        GOOD.replace("qw", "qw,orientation_std").replace("0,0,0,1", "0,0,0,1,1").replace("0.8\n", "0.8,-1e-5\n"),
        ["'orientation_std'", "row 2", "greater than 0"],
    ),
    "a row too long": (GOOD + "3,1,1,1,0,0,0,1,9,9,9\n", []),
}  # fmt: skip


@pytest.mark.parametrize("content, named", REFUSALS.values(), ids=REFUSALS)
def test_table_is_refused(content, named, read):
    """One InputError, one line: the file, and the column and row where there are any."""
    with pytest.raises(InputError) as refusal:
        read(content)
    message = str(refusal.value)
    assert "poses.csv" in message
    assert "\n" not in message
    for words in named:
        assert words in message.partition("poses.csv")[2], f"{words!r} is not in {message!r}"


def test_a_column_twice_is_refused(read):
    """Which of the two is meant can't be known."""
    tails = (",leg1_slide", ",1", ",1", ",1")
    with pytest.raises(InputError, match="leg1_slide"):
        read("\n".join(line + tail for line, tail in zip(GOOD.splitlines(), tails, strict=True)) + "\n")


def test_a_missing_file_and_one_that_is_no_parquet(tmp_path):
    with pytest.raises(InputError, match=r"absent\.csv: can't be read"):
        read_table(tmp_path / "absent.csv", JOINTS, measure())
    with pytest.raises(InputError, match=r"absent\.parquet"):
        read_table(tmp_path / "absent.parquet", JOINTS, measure())
    (tmp_path / "false.parquet").write_text(GOOD)
    with pytest.raises(InputError, match=r"false\.parquet: not a table"):
        read_table(tmp_path / "false.parquet", JOINTS, measure())
    with pytest.raises(InputError, match="can't be read"):
        read_table(tmp_path, JOINTS, measure())


def test_a_map_of_a_column_that_no_table_has(read):
    with pytest.raises(InputError, match=r"measure\.columns: 'leg1_slid'.*'leg1_slide'"):
        read(GOOD, columns={"leg1_slid": {"from": "a"}})
    with pytest.raises(InputError, match=r"column 'meas_x' \(x\) is missing"):
        read(GOOD, columns={"x": {"from": "meas_x"}})


def test_joint_values_in_millimetres_are_refused_with_a_hint(robot, tmp_path):
    loaded = robot("ups3_s")
    readings = loaded.readings(4, 0)
    file = tmp_path / "poses.csv"
    for factor, refused in ((1.0, False), (1e3, True)):
        table = to_table(JOINTS, factor * readings, {})
        arguments = (table, loaded.chain, loaded.model.actuators, loaded.description.tolerance, file)
        if refused:
            with pytest.raises(
                InputError, match=r"poses\.csv: pose 0: joint 'leg1_slide' .*\[0\.35, 0\.65\]; is it in mm"
            ):
                check_readings(*arguments)
        else:
            check_readings(*arguments)


def test_joint_values_beyond_the_limits_name_pose_and_joint(robot, tmp_path):
    loaded = robot("ups3_s")
    readings = loaded.readings(4, 0)
    readings[2, 1] = 0.7
    table = to_table(JOINTS, readings, {})
    with pytest.raises(
        InputError, match=r"pose 2: joint 'leg2_slide' would be at 0\.7 m; its limits are \[0\.35, 0\.65\]$"
    ):
        check_readings(table, loaded.chain, loaded.model.actuators, loaded.description.tolerance, tmp_path / "t.csv")


def test_joint_values_alone_are_a_table_where_nothing_need_be_measured(tmp_path):
    file = tmp_path / "joints.csv"
    file.write_text("leg1_slide,leg2_slide,leg3_slide\n0.4,0.5,0.6\n")
    found = to_measurements(read_table(file, JOINTS, measure(), measured=False), JOINTS, Sensor())
    assert found.channels == ()
    np.testing.assert_array_equal(found.readings, [[0.4, 0.5, 0.6]])


@given(
    readings=arrays(float, (4, 3), elements=st.floats(-1e3, 1e3)),
    vectors=arrays(float, (4, 3), elements=st.floats(-3, 3)),
    position=arrays(float, (4, 3), elements=st.floats(-1e3, 1e3)),
)
def test_written_and_read_again_a_table_is_the_same(readings, vectors, position):
    """Table -> CSV text -> table, bit for bit, as floats are printed in full."""
    quaternion = quaternions(Rotation.from_rotvec(vectors).as_matrix())
    measured = dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True)) | dict(
        zip("xyz", position.T, strict=True)
    )
    table = to_table(JOINTS, readings, measured)
    text = io.StringIO()
    table.to_csv(text, index=False)
    again = _read_text(text.getvalue(), JOINTS)
    pd.testing.assert_frame_equal(again[list(table.columns)], table, check_exact=True)


@given(vectors=arrays(float, (5, 3), elements=st.floats(-3, 3)))
def test_quaternions_are_scipys_with_w_not_negative(vectors):
    rotation = Rotation.from_rotvec(vectors)
    found = quaternions(rotation.as_matrix())
    assert np.all(found[:, 3] >= 0)
    np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), rotation.as_matrix(), rtol=0, atol=1e-14)


def test_rows_are_selected_in_every_channel(read):
    found = to_measurements(read(GOOD), JOINTS, Sensor())
    part = found[np.array([2, 0])]
    np.testing.assert_array_equal(part.pose, [2, 0])
    np.testing.assert_array_equal(part.readings, found.readings[[2, 0]])
    np.testing.assert_array_equal(part.values["orientation"], found.values["orientation"][[2, 0]])
    assert "position" not in part.values
