"""RAO tables: kincal's own format, the MSS structure, and what is refused."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.constants import knot
from scipy.io import savemat

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.rao import MODES, RaoTable
from kincal.pipeline.sea.rao_files import read_rao
from kincal.pipeline.sea.settings import Seaway, Vessel
from kincal.pipeline.sea.synthesis import rao_of
from kincal.urdf.errors import InputError

ANGLES = MODES[3:]


def table(directions_deg, frequencies=(0.2, 0.4, 0.6, 0.8, 1.2, 2.0), speeds_knots=(0.0,)) -> pd.DataFrame:
    """kincal's own table of the default vessel's closed forms."""
    rows = []
    for speed in speeds_knots:
        for w in frequencies:
            for direction in directions_deg:
                values = ClosedFormRao(Vessel()).response(np.array(w), np.deg2rad(direction), speed * knot)
                row = {"speed_knots": speed, "frequency": w, "direction_deg": direction}
                for mode, value in zip(MODES, values, strict=True):
                    name = f"{mode}_deg" if mode in ANGLES else mode
                    row[name] = abs(value) * (180 / np.pi if mode in ANGLES else 1)
                    row[f"{mode}_phase_deg"] = np.angle(value, deg=True)
                rows.append(row)
    return pd.DataFrame(rows)


def written(raw: pd.DataFrame, folder, name="rao.csv"):
    file = folder / name
    if file.suffix == ".csv":
        raw.to_csv(file, index=False)
    else:
        raw.to_parquet(file)
    return file


@pytest.mark.parametrize("name", ["rao.csv", "rao.parquet"])
@pytest.mark.parametrize("half", [True, False])
def test_a_table_gives_back_what_it_was_made_of(tmp_path, name, half):
    """At its own frequencies and directions; 0 to 180 degrees are mirrored."""
    file = written(table(range(0, 181, 30) if half else range(0, 360, 30)), tmp_path, name)
    w, beta = np.array([0.2, 0.8, 2.0])[:, None], np.deg2rad([0.0, 60.0, 180.0, 300.0, 330.0, 390.0])
    expected = ClosedFormRao(Vessel()).response(w, beta, 0.0)
    assert read_rao(file, 0.0).response(w, beta, 0.0) == pytest.approx(expected, abs=1e-9)


def test_rows_come_in_any_order(tmp_path):
    raw = table(range(0, 360, 30))
    one = read_rao(written(raw, tmp_path), 0.0)
    other = read_rao(written(raw.sample(frac=1, random_state=0), tmp_path, "shuffled.csv"), 0.0)
    assert np.array_equal(one.values, other.values)


def test_of_several_speeds_the_nearest_is_taken(tmp_path):
    file = written(table(range(0, 181, 30), speeds_knots=(0.0, 10.0, 20.0)), tmp_path)
    expected = ClosedFormRao(Vessel()).response(np.array(0.6), np.array(np.pi), 10 * knot)
    assert read_rao(file, 12 * knot).response(np.array(0.6), np.array(np.pi), 12 * knot) == pytest.approx(expected)
    with pytest.raises(InputError, match=r"rao\.csv: speed_knots = 25: the table has 0 to 20 knots"):
        read_rao(file, 25 * knot)


def test_surge_sway_and_yaw_may_be_left_out(tmp_path):
    raw = table(range(0, 181, 30))
    few = raw[[c for c in raw.columns if c.split("_")[0] not in ("surge", "sway", "yaw")]]
    found = read_rao(written(few, tmp_path), 0.0).values
    assert (found[..., [0, 1, 5]] == 0).all()
    assert (np.abs(found[..., 2]) > 0).any()


@given(st.floats(0.25, 1.9), st.floats(-10.0, 10.0))
def test_between_the_rows_amplitudes_stay_between_theirs(w, direction):
    grid = np.array([0.2, 0.4, 0.9, 2.0]), np.deg2rad(np.arange(0.0, 360.0, 30.0))
    values = ClosedFormRao(Vessel()).response(grid[0][:, None], grid[1], 0.0)
    found = np.abs(RaoTable(*grid, values).response(np.array(w), np.array(direction), 0.0))
    i = np.searchsorted(grid[0], w) - 1
    j = int(np.mod(direction, 2 * np.pi) // np.deg2rad(30.0)) % 12
    corners = np.abs(values[[i, i, i + 1, i + 1], [j, (j + 1) % 12, j, (j + 1) % 12]])
    assert (found <= corners.max(axis=0) + 1e-12).all()
    assert (found >= corners.min(axis=0) - 1e-12).all()


def test_beyond_its_frequencies_the_ship_does_not_move(tmp_path):
    rao = read_rao(written(table(range(0, 181, 30)), tmp_path), 0.0)
    assert not rao.response(np.array([0.1, 2.1]), np.array(1.0), 0.0).any()


def test_the_mss_structure_is_the_same_ship_in_other_axes(tmp_path):
    """Written with x forward, y to starboard, z down and headings to starboard; a single speed and the usual ten."""
    w, headings = np.array([0.2, 0.5, 1.0]), np.deg2rad(np.arange(0.0, 360.0, 10.0))
    expected = ClosedFormRao(Vessel()).response(w[:, None], -headings, 0.0)
    theirs = expected * [1, -1, -1, 1, -1, -1]
    for speeds, name in ((1, "one.mat"), (10, "ten.mat")):
        cells = np.empty((2, 6), dtype=object)
        for mode in range(6):
            padded = np.zeros((3, 36, speeds), dtype=complex)
            padded[:, :, 0] = theirs[:, :, mode]
            cells[0, mode], cells[1, mode] = np.abs(padded), np.angle(padded) + 4 * np.pi
        rao = {"amp": cells[0], "phase": cells[1], "w": w}
        savemat(tmp_path / name, {"vessel": {"motionRAO": rao, "headings": headings, "velocities": 0.0}})
        found = read_rao(tmp_path / name, 0.0).response(w[:, None], -headings, 0.0)
        assert found == pytest.approx(expected, abs=1e-9)


def test_what_is_no_table_is_refused(tmp_path):
    raw = table(range(0, 181, 30))

    def refused(changed, *words, name="rao.csv"):
        file = changed if name is None else written(changed, tmp_path, name)
        with pytest.raises(InputError) as error:
            read_rao(file, 0.0)
        assert "\n" not in str(error.value)
        for word in (str(file), *words):
            assert word in str(error.value)

    refused(raw.drop(columns="roll_deg"), "'roll_deg' is missing")
    refused(raw.drop(columns="surge_phase_deg"), "'surge_phase_deg' is missing")
    refused(raw.rename(columns={"heave": "heeve"}), "unknown column 'heeve'")
    refused(raw[:0], "no row")
    refused(raw.drop(index=4), "41 rows", "42 rows")
    refused(pd.concat([raw.drop(index=4), raw[:1]]), "each combination once")
    refused(raw.assign(heave=np.where(raw.index == 3, np.nan, raw["heave"])), "'heave'", "row 4")
    refused(table((0.0, 90.0, 180.0, 270.0)), "directions 0 to 270", "45 degrees")
    refused(table((0.0, 90.0)), "directions 0 to 90")
    refused(table(range(0, 181, 30), frequencies=(-0.2, 0.4)), "greater than 0")
    refused(table(range(0, 181, 30), frequencies=(0.4,)), "two or more")
    (tmp_path / "text.mat").write_text("no matrix")
    refused(tmp_path / "text.mat", "not a MATLAB file", name=None)
    savemat(tmp_path / "other.mat", {"ship": 1.0})
    refused(tmp_path / "other.mat", "no vessel structure", name=None)
    refused(tmp_path / "missing.mat", "can't be read", name=None)


def test_a_table_of_other_frequencies_than_the_seas_is_refused(tmp_path):
    file = written(table(range(0, 181, 30), frequencies=(0.9, 1.2, 2.0, 6.0)), tmp_path)
    assert rao_of(Seaway(rao=file, sea_state=3, peak_period_s=3.5)).response(np.array(1.0), np.array(0.0), 0.0).any()
    with pytest.raises(
        InputError, match=r"0\.9 to 6 rad/s have \d+% of the energy of waves with a peak period of 9\.7 s"
    ):
        rao_of(Seaway(rao=file))
