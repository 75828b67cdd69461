"""measure.skip: poses of the table that are left out by their numbers."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.measurement_table import noted_table, read_table
from kincal.identification.skipped_poses import spans
from kincal.urdf.description import Measure
from kincal.urdf.errors import TableError

JOINTS = ("slide", "hinge")


@pytest.fixture
def file(tmp_path):
    random = np.random.default_rng(2)
    table = pd.DataFrame({"pose": [4, 5, 6, 9, 10]} | {name: random.normal(size=5) for name in (*JOINTS, *"xyz")})
    table.to_csv(tmp_path / "table.csv", index=False)
    return tmp_path / "table.csv"


def of(file, skip, **more) -> Measure:
    return Measure.model_validate({"table": file, "skip": skip, **more})


def test_the_others_stay_as_they_are(file):
    whole = read_table(file, JOINTS, of(file, []))
    table, notes = noted_table(file, JOINTS, of(file, [9, 4]))
    expected = whole[~whole["pose"].isin([4, 9])].reset_index(drop=True)
    pd.testing.assert_frame_equal(table, expected)
    assert notes == (f"{file}: poses 4, 9: left out by measure.skip",)


def test_without_a_column_of_numbers_rows_count_from_zero(file):
    pd.read_csv(file).drop(columns="pose").to_csv(file, index=False)
    assert read_table(file, JOINTS, of(file, [0, 3]))["pose"].tolist() == [1, 2, 4]


def test_what_a_skipped_row_holds_does_not_matter(file):
    """It is the way out where one row cannot be read; the message of another names its row of the file."""
    lines = file.read_text().splitlines()
    lines[2] = "5,broken,,1,2,3"
    file.write_text("\n".join(lines))
    assert read_table(file, JOINTS, of(file, [5]))["pose"].tolist() == [4, 6, 9, 10]
    lines[4] = "9,0.1,0.2,oops,2,3"
    file.write_text("\n".join(lines))
    with pytest.raises(TableError, match="column 'x', row 4: found 'oops'"):
        read_table(file, JOINTS, of(file, [5]))


def test_unknown_numbers_are_refused_with_those_that_exist(file):
    with pytest.raises(TableError, match=r"measure\.skip: no pose 7, 8; allowed are 4 to 6, 9 to 10"):
        read_table(file, JOINTS, of(file, [4, 7, 8]))
    with pytest.raises(TableError, match="leaves out all 5 poses"):
        read_table(file, JOINTS, of(file, [4, 5, 6, 9, 10]))


@given(st.sets(st.integers(-20, 60), min_size=1))
def test_spans_name_each_number_once(numbers):
    named: list[int] = []
    for part in spans(numbers).split(", "):
        first, _, last = part.partition(" to ")
        named += range(int(first), int(last or first) + 1) if part != "..." else []
    assert named == sorted(numbers)[: len(named)]
    assert len(named) == len(numbers) or spans(numbers).endswith("...")


def test_a_calibration_skips_in_its_own_table_only(tmp_path):
    """Joint values for a prediction have other numbers; a table that is given in place of measure.table is skipped."""
    import kincal

    robot = kincal.load("ups3_s", {"plan.poses": 14})
    table = kincal.measure(robot, seed=3)
    less = kincal.identify(kincal.load("ups3_s", {"plan.poses": 14, "measure.skip": [2, 7]}), table)
    plain = kincal.identify(robot, table.drop(index=[2, 7]))
    assert less.identification.n_poses == 12
    np.testing.assert_allclose(less.parameters["identified"], plain.parameters["identified"], rtol=1e-9, atol=1e-12)
