"""Motive and Qualisys exports: rigid bodies and markers, gaps, units, and poses out of frames."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kincal.identification.measurement_table import noted_table
from kincal.identification.table_files import load
from kincal.urdf.description import Measure, load_robot
from kincal.urdf.errors import InputError
from tests.identification.exports import QUATERNION, motive, qualisys

JOINTS = ("slide", "hinge")


def body(n: int, seed: int, solid: bool = True, gaps: tuple[int, ...] = ()) -> pd.DataFrame:
    random = np.random.default_rng(seed)
    table = pd.DataFrame({"frame": np.arange(n) + 1.0, "t": np.arange(n) / 100})
    table[["x", "y", "z"]] = random.normal(size=(n, 3))
    if solid:
        table[QUATERNION] = Rotation.random(n, rng=random).as_quat(canonical=True)
    table.loc[list(gaps), table.columns[2:]] = np.nan
    return table


def read(text: str, folder, encoding: str = "utf-8", **of_measure) -> pd.DataFrame:
    file = folder / "export.txt"
    file.write_bytes(text.encode(encoding))
    return load(file, Measure.model_validate({"table": file, **of_measure}))


def assert_same(table: pd.DataFrame, expected: pd.DataFrame) -> None:
    assert list(table) == list(expected)
    pd.testing.assert_frame_equal(table.drop(columns=QUATERNION, errors="ignore"),
                                  expected.drop(columns=QUATERNION, errors="ignore"), rtol=0, atol=1e-8)  # fmt: skip
    if "qx" in expected:
        known = expected["x"].notna().to_numpy()
        a, b = (t.loc[known, QUATERNION].to_numpy() for t in (table, expected))
        np.testing.assert_allclose(np.abs((a * b).sum(axis=1)), 1, rtol=0, atol=1e-13)
        assert table.loc[~known, QUATERNION].isna().all(axis=None)


@given(
    unit=st.sampled_from(["Meters", "Centimeters", "Millimeters"]),
    rotation=st.sampled_from(["Quaternion", "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]),
    named=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
    n=st.integers(1, 9),
    data=st.data(),
)
def test_motive(tmp_path_factory, unit, rotation, named, encoding, n, data):
    gaps = tuple(data.draw(st.sets(st.integers(0, n - 1))))
    bodies = {"arm": body(n, 1), "platform": body(n, 2, gaps=gaps), "m 1": body(n, 3, solid=False)}
    text, folder = motive(bodies, unit, rotation, named), tmp_path_factory.mktemp("motive")
    for name, expected in bodies.items():
        assert_same(read(text, folder, encoding, body=name), expected)


@given(columns=st.booleans(), time=st.booleans(), blank=st.booleans(), n=st.integers(1, 9), data=st.data())
def test_qualisys(tmp_path_factory, columns, time, blank, n, data):
    gaps = tuple(data.draw(st.sets(st.integers(1, n - 1)))) if n > 1 else ()
    for solid in (True, False):
        bodies = {"Base plate": body(n, 1, solid), "platform": body(n, 2, solid, gaps)}
        text, folder = qualisys(bodies, columns, time, blank), tmp_path_factory.mktemp("qtm")
        for name, expected in bodies.items():
            assert_same(read(text, folder, body=name), expected)


def test_a_row_as_qualisys_wrote_it(tmp_path):
    """Of a model ship in a basin: the angles beside the matrix are intrinsic XYZ, so they say how it is ordered."""
    names = "Frame Time PSVH_X Y Z Roll Pitch Yaw Residual " + " ".join(f"Rot[{k}]" for k in range(9))
    row = (
        "1 0.00000 -194.91974 2.24150 0.99661 -0.65630 0.09391 0.05772 4.98536 "
        "1.00000 0.00099 -0.00165 -0.00101 0.99993 -0.01145 0.00164 0.01145 0.99993"
    )
    head = "NO_OF_FRAMES\t1\nNO_OF_CAMERAS\t4\nNO_OF_BODIES\t1\nFREQUENCY\t100\nDATA_INCLUDED\t6D\nBODY_NAMES\tPSVH\n"
    text = head + "\t".join(names.split()).replace("_", " ") + "\t\n" + "\t".join(row.split()) + "\t\n"
    table = read(text, tmp_path)
    np.testing.assert_allclose(table[["x", "y", "z"]], [[-0.19491974, 0.0022415, 0.00099661]], rtol=1e-12)
    expected = Rotation.from_euler("XYZ", [-0.65630, 0.09391, 0.05772], degrees=True)
    assert (Rotation.from_quat(table[QUATERNION].to_numpy()[0]).inv() * expected).magnitude() < 2e-5


def test_the_only_body_needs_no_name_and_others_are_listed(tmp_path):
    one, marker, other = body(3, 1), body(3, 2, solid=False), body(3, 3)
    assert_same(read(motive({"marker": marker, "platform": one}), tmp_path), one)
    assert_same(read(motive({"marker": marker}), tmp_path), marker)
    both = {"arm": other, "platform": one, "marker": marker}
    with pytest.raises(InputError, match=r"2 rigid bodies: set measure\.body; allowed are arm, platform"):
        read(motive(both), tmp_path)
    with pytest.raises(InputError, match="has the name 'table'; allowed are arm, platform, marker"):
        read(motive(both), tmp_path, body="table")
    with pytest.raises(InputError, match=r"2 rigid bodies: set measure\.body"):
        read(qualisys({"arm": other, "platform": one}), tmp_path)
    with pytest.raises(InputError, match="Length Units: found 'Cubits'; allowed are meters"):
        read(motive({"arm": one}).replace("Meters", "Cubits"), tmp_path)


@pytest.mark.parametrize("form", ["motive", "qualisys"])
@pytest.mark.parametrize("name", ["gough_stewart", "ur10", "ups3_s"])
def test_poses_out_of_frames(form, name, tmp_path):
    """A robot stands at each pose for some frames; one pose is hidden, single frames are missing."""
    joints, random = load_robot(name).description.actuated, np.random.default_rng(7)
    poses, per = body(6, 4), 12
    frames = poses.loc[np.repeat(np.arange(6), per)].reset_index(drop=True)
    frames["frame"], frames["t"] = np.arange(len(frames)) + 1.0, np.arange(len(frames)) / 100
    frames[["x", "y", "z"]] += 1e-5 * random.normal(size=(len(frames), 3))
    frames.loc[[3, 4, *range(2 * per, 3 * per)], frames.columns[2:]] = np.nan
    file, beside = tmp_path / "take.csv", tmp_path / "joints.csv"
    file.write_text({"motive": motive, "qualisys": qualisys}[form]({"platform": frames}))
    begin = np.arange(6) * per + 1.0
    rows = pd.DataFrame({"pose": np.arange(6) + 10} | {joint: random.normal(size=6) for joint in joints})
    windows = (
        {"frame_from": begin, "frame_to": begin + per - 1},
        {"t_from": (begin - 1) / 100 - 1e-4, "t_to": (begin + per - 2) / 100 + 1e-4},
        {"frame": begin},
    )
    measure = Measure.model_validate({"table": file, "joints": beside})
    seen = [0, 1, 3, 4, 5]
    for window in windows:
        rows.assign(**window).to_csv(beside, index=False)
        table, notes = noted_table(file, joints, measure)
        assert table["pose"].tolist() == [10, 11, 13, 14, 15]
        np.testing.assert_array_equal(table[list(joints)], rows.loc[seen, list(joints)])
        np.testing.assert_allclose(table[["x", "y", "z"]], poses.loc[seen, ["x", "y", "z"]], rtol=0, atol=4e-5)
        turn = [Rotation.from_quat(t[QUATERNION].to_numpy()) for t in (table, poses.loc[seen])]
        assert (turn[0].inv() * turn[1]).magnitude().max() < 1e-7
        text = " ".join(notes)
        assert "rigid body 'platform' in 72 frames, 14 of them without it" in text
        assert "1 of 6 rows have no measurement and are skipped: rows 3" in text
        assert ("means of 12 to 12 frames" in text) == ("frame" not in window)


def test_frames_that_do_not_go_together_are_refused(tmp_path):
    file, beside = tmp_path / "take.csv", tmp_path / "joints.csv"
    file.write_text(motive({"platform": body(4, 1)}))
    measure = Measure.model_validate({"table": file, "joints": beside})
    rows = pd.DataFrame({"slide": [1.0, 2, 3], "hinge": [0.1, 0.2, 0.3]})
    for more, words in (
        ({}, "3 rows for 4 rows of .*: which go together"),
        ({"frame": [1, 2, 9]}, "row 3: frame = 9: no frame there; the export has 1 to 4"),
        ({"frame_from": [1, 3, 2], "frame_to": [1, 2, 4]}, "row 2: frame_from = 3 and frame_to = 2: no frame there"),
        ({"t_from": [0, 0, 5], "t_to": [1, 1, 6]}, "row 3: t_from = 5 and t_to = 6: no frame there"),
    ):
        rows.assign(**more).to_csv(beside, index=False)
        with pytest.raises(InputError, match=words):
            noted_table(file, JOINTS, measure)
    rows.drop(columns="hinge").to_csv(beside, index=False)
    with pytest.raises(InputError, match=r"joints\.csv: column 'hinge' is missing; it has slide"):
        noted_table(file, JOINTS, measure)
    with pytest.raises(InputError, match=r"a Motive export: .*no joint values\. Set measure\.joints"):
        noted_table(file, JOINTS, Measure(table=file))


def test_joint_values_beside_a_plain_table(tmp_path):
    """By pose where both have it, else in their order; a table with joints keeps its own."""
    file, beside = tmp_path / "tracker.csv", tmp_path / "joints.csv"
    measured = body(3, 1)[["x", "y", "z"]]
    rows = pd.DataFrame({"pose": [7, 5, 6], "J1": [1000.0, 2000, 3000], "hinge": [0.1, 0.2, 0.3]})
    rows.to_csv(beside, index=False)
    columns = {"slide": {"from": "J1", "unit": "mm"}}
    measure = Measure.model_validate({"table": file, "joints": beside, "columns": columns})
    measured.to_csv(file, index=False)
    table, notes = noted_table(file, JOINTS, measure)
    assert table["pose"].tolist() == [7, 5, 6]
    np.testing.assert_allclose(table["slide"], [1, 2, 3])
    np.testing.assert_allclose(table[["x", "y", "z"]], measured)
    assert "in their order" in notes[0]
    measured.assign(pose=[5, 6, 7]).to_csv(file, index=False)
    np.testing.assert_allclose(noted_table(file, JOINTS, measure)[0][["x", "y", "z"]], measured.iloc[[2, 0, 1]])
    measured.assign(J1=0.0, hinge=0.0).to_csv(file, index=False)
    table, notes = noted_table(file, JOINTS, measure)
    assert (table["hinge"] == 0).all()
    assert "measure.joints is not used" in notes[0]
