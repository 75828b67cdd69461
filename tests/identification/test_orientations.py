"""Orientations as Euler angles of every order and as rotation vectors, against products of elementary rotations."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.identification.measurement_table import measured_poses, noted_table
from kincal.urdf.description import EULER_ORDERS, Measure, load_robot
from kincal.urdf.errors import InputError

JOINTS = ("slide_1", "slide_2")


def elementary(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def product(order: str, angles: np.ndarray) -> np.ndarray:
    """Turned axes: the first rotation stands left. Fixed axes: it stands right."""
    first, second, third = (elementary(axis, angle) for axis, angle in zip(order.lower(), angles, strict=True))
    return first @ second @ third if order.isupper() else third @ second @ first


def read(table: pd.DataFrame, **of_measure) -> np.ndarray:
    """(n, 3, 3) the orientations of a table without a file."""
    measure = Measure.model_validate({"table": "t.csv", **of_measure})
    poses, _ = measured_poses(table, JOINTS, measure, "t.csv")
    return Rotation.from_quat(poses[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()


def joints(n: int) -> dict[str, np.ndarray]:
    return {name: np.linspace(0.1, 0.2, n) for name in JOINTS}


angle_rows = st.lists(st.tuples(*[st.floats(-np.pi, np.pi)] * 3), min_size=1, max_size=4)


@settings(deadline=None)
@given(order=st.sampled_from(EULER_ORDERS), rows=angle_rows, degrees=st.booleans(), mapped=st.booleans())
def test_every_order_is_its_product_of_rotations(order, rows, degrees, mapped):
    angles = np.array(rows)
    names = ("A", "B", "C") if mapped else ("euler_1", "euler_2", "euler_3")
    shown = np.rad2deg(angles) if degrees else angles
    table = pd.DataFrame(joints(len(angles)) | dict(zip(names, shown.T, strict=True)))
    unit = "deg" if degrees else "rad"
    canonical = ("euler_1", "euler_2", "euler_3")
    columns = {c: {"from": name, "unit": unit} for c, name in zip(canonical, names, strict=True)}
    rotations = read(table, euler=order, columns=columns if mapped or degrees else {})
    np.testing.assert_allclose(rotations, [product(order, row) for row in angles], rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", [order for order in EULER_ORDERS if len(set(order)) == 3])
def test_rx_ry_rz_are_angles_about_their_axes(order):
    angles = np.array([[0.3, -0.2, 0.9], [1.1, 0.4, -2.0]])
    by_axis = {f"r{axis}": angles[:, k] for k, axis in enumerate(order.lower())}
    rotations = read(pd.DataFrame(joints(2) | by_axis), euler=order)
    np.testing.assert_allclose(rotations, [product(order, row) for row in angles], rtol=0, atol=1e-12)


def test_without_a_setting_rx_ry_rz_stay_intrinsic_xyz():
    table = pd.DataFrame(joints(1) | {"rx": [0.3], "ry": [-0.2], "rz": [0.9]})
    np.testing.assert_allclose(read(table), read(table, euler="XYZ"), rtol=0, atol=1e-15)


@settings(deadline=None)
@given(rows=angle_rows, degrees=st.booleans())
def test_a_rotation_vector_by_its_exponential_series(rows, degrees):
    vectors = np.array(rows)
    shown = np.rad2deg(vectors) if degrees else vectors
    table = pd.DataFrame(joints(len(vectors)) | dict(zip(("rx", "ry", "rz"), shown.T, strict=True)))
    columns = {name: {"from": name, "unit": "deg"} for name in ("rx", "ry", "rz")} if degrees else {}
    for rotation, (x, y, z) in zip(read(table, rotation_vector=True, columns=columns), vectors, strict=True):
        step = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / 2**20
        series = np.eye(3) + step + step @ step / 2
        for _ in range(20):
            series = series @ series
        np.testing.assert_allclose(rotation, series, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["gough_stewart", "ur10", "ups3_s"])
def test_a_file_in_another_notation_is_the_same_table(name, tmp_path):
    """On robots with point loops, without loops and with three axes; sigmas and positions stay as they are."""
    random, actuated = np.random.default_rng(4), load_robot(name).description.actuated
    rotation, n = Rotation.random(7, rng=5), 7
    plain = pd.DataFrame({"pose": np.arange(n) + 2} | {joint: random.normal(size=n) for joint in actuated})
    plain[["x", "y", "z"]] = random.normal(size=(n, 3))
    plain["orientation_std"] = 1e-4
    zyz = plain.assign(**dict(zip(("C", "B", "A"), rotation.as_euler("ZYZ", degrees=True).T, strict=True)))
    columns = {f"euler_{k + 1}": {"from": column, "unit": "deg"} for k, column in enumerate("CBA")}
    quaternion = rotation.as_quat(canonical=True)
    expected = plain.assign(**dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True)))
    file = tmp_path / "table.csv"
    zyz.to_csv(file, index=False)
    table, notes = noted_table(
        file, actuated, Measure.model_validate({"table": file, "euler": "ZYZ", "columns": columns})
    )
    pd.testing.assert_frame_equal(table[list(expected)], expected, rtol=1e-12, check_dtype=False)
    assert notes == ()


def test_a_row_of_units_counts_for_angles(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("slide_1,slide_2,rx,ry,rz\nm,m,deg,deg,deg\n0.1,0.2,10,20,30\n")
    table, _ = noted_table(file, JOINTS, Measure.model_validate({"table": file, "euler": "xyz"}))
    expected = product("xyz", np.deg2rad([10, 20, 30]))
    quaternion = table[["qx", "qy", "qz", "qw"]].to_numpy()
    np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix()[0], expected, rtol=0, atol=1e-12)


ANGLES = {"euler_1": [0.1], "euler_2": [0.2], "euler_3": [0.3]}
BY_AXIS = {"rx": [0.1], "ry": [0.2], "rz": [0.3]}
POSITION = {"x": [1.0], "y": [2.0], "z": [3.0]}
QUATERNION = {"qx": [0.0], "qy": [0.0], "qz": [0.0], "qw": [1.0]}


@pytest.mark.parametrize(
    "columns, of_measure, words",
    [
        (ANGLES, {"euler": "Zyx"}, ["euler", "'Zyx'", "ZYX", "lower case"]),
        (ANGLES, {"euler": "XXZ"}, ["euler", "'XXZ'", "XYZ"]),
        (ANGLES, {"euler": "ZYX", "rotation_vector": True}, ["euler", "rotation_vector", "only one"]),
        (ANGLES, {"columns": {"euler_1": "a"}}, ["columns.euler_1", "measure.euler"]),
        (ANGLES, {"euler": "ZYX", "columns": {"euler_1": "euler_1", "rx": "euler_2"}}, ["euler_1 and rx"]),
        (ANGLES, {}, ["nothing was measured", "euler_3 (with measure.euler)"]),
        (ANGLES | POSITION, {}, ["euler_1, euler_2, euler_3", "set measure.euler"]),
        (POSITION, {"euler": "ZYX"}, ['measure.euler = "ZYX"', "euler_1", "it has slide_1", "[measure.columns]"]),
        (POSITION, {"rotation_vector": True}, ["measure.rotation_vector = true", "rx, ry, rz"]),
        (BY_AXIS, {"euler": "ZYZ"}, ["turns about z twice", "euler_1, euler_2, euler_3"]),
        (ANGLES | QUATERNION, {"euler": "ZYX"}, ["qx, qy, qz, qw", "two orientations", "delete measure.euler"]),
        (BY_AXIS | {"ry": [20.0]}, {"rotation_vector": True}, ["'ry', row 1", "found 20 rad", 'unit = "deg"']),
        ({"euler_1": [0.1], "euler_2": [0.1]}, {"euler": "ZYX"}, ["euler_1, euler_2", "not euler_3"]),
    ],
)
def test_refusals_name_the_setting_and_its_cure(columns, of_measure, words):
    table = pd.DataFrame(joints(1) | columns)
    with pytest.raises((InputError, ValueError)) as refusal:
        measured_poses(table, JOINTS, Measure.model_validate({"table": "t.csv", **of_measure}), "t.csv")
    for word in words:
        assert word in str(refusal.value), str(refusal.value)


def test_a_quaternion_needs_no_notation():
    """Tables that kincal writes itself are read under the settings of the user's table."""
    np.testing.assert_allclose(read(pd.DataFrame(joints(1) | QUATERNION), euler="ZYX")[0], np.eye(3))
