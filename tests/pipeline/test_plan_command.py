"""`kincal plan`, and D-optimal poses in the plan stage."""

import io
import json

import numpy as np
import pandas as pd
import pytest

from kincal.identification.accuracy import score
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurement_table import read_table
from kincal.identification.poses import planned
from kincal.pipeline.planning.layouts import LAYOUTS, MOST, Wanted, planner
from kincal.pipeline.run.stage import all_stages
from kincal.urdf.description import Plan
from kincal.urdf.kinematics import tool_coordinates
from kincal.urdf.workspace import AXES, condition_numbers

SCORE = {"layout", "n_poses", "excited", "excitable", "o1", "o2", "o3", "o4", "o5", "condition_number"}
SCORE |= {f"{what}_{unit}" for what in ("mean", "rms", "max") for unit in ("deg", "mm")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A store that all tests here share; the model stage is all that stands in it."""
    return tmp_path_factory.mktemp("plans") / "store"


@pytest.fixture
def plan(cli, folder):
    """plan(robot, *options) -> Answer."""
    return lambda robot, *options: cli("plan", robot, "--store", folder, *options)


@pytest.fixture
def document(plan):
    """document(robot, *options): the one JSON document on stdout."""

    def found(*arguments) -> dict:
        answer = plan(*arguments, "--json")
        assert answer.status == 0, answer.err
        return json.loads(answer.out, parse_constant=lambda constant: pytest.fail(f"{constant} is no JSON"))

    return found


def read(text: str) -> pd.DataFrame:
    return pd.read_csv(io.StringIO(text))


def the_planner(start, folder, robot: str, *overrides: str):
    run, _ = start(folder, *overrides, robot=robot)
    return planner(run.robot.description, run.until("model")[0].chain())


# The table that the operator takes to the machine


@pytest.mark.parametrize("robot", ["ups3_s", "jugglebot", "ur10"])
def test_the_table_holds_readings_and_planned_coordinates(plan, start, folder, robot):
    """The loops closed at the readings give the coordinates back; limits and conditioning are kept."""
    answer = plan(robot, "--poses", "12")
    assert answer.status == 0, answer.err
    table, plans = read(answer.out), the_planner(start, folder, robot)
    chain = plans.model.chain
    coordinates = [f"planned_{AXES[a]}_{'mm' if a < 3 else 'deg'}" for a in chain.tool_axes]
    assert list(table) == ["pose", *chain.actuated_names, *coordinates]
    assert list(table["pose"]) == list(range(12))
    closure = plans.model.robot(np.zeros(len(plans.model.parameters))).close(table[list(chain.actuated_names)].values)
    assert closure.closed.all()
    assert np.all((closure.q >= chain.lower - 1e-8) & (closure.q <= chain.upper + 1e-8))
    assert condition_numbers(chain, closure.q).max() <= plans.workspace.max_condition
    scale = np.array([1e3 if a < 3 else 180 / np.pi for a in chain.tool_axes])
    back = tool_coordinates(chain, closure.pose)[:, list(chain.tool_axes)] * scale
    np.testing.assert_allclose(back, table[coordinates], rtol=0, atol=2e-5)


def test_readings_are_in_the_actuators_own_unit(plan):
    """Jugglebot's legs count revolutions, from some 0.64 m up."""
    table = read(plan("jugglebot", "--poses", "5", "--layout", "random").out)
    legs = 0.6401966443145985 + 0.075692 * table["leg1_slide"]
    assert legs.between(0.5, 1.1).all()
    assert table["leg1_slide"].between(0, 6).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_stage_and_the_command_have_the_same_poses(plan, start, folder, layout):
    """The d_optimal ones also in the same order."""
    joints = ["leg1_slide", "leg2_slide", "leg3_slide"]
    stage = start(folder, "plan.poses=10", f"plan.layout={layout}")[0].until("plan")[0].table[joints]
    answer = plan("ups3_s", "--poses", "10", "--layout", layout, "--set", 'measure.channels=["orientation"]')
    tables = [stage, read(answer.out)[joints]]
    if layout != "d_optimal":
        tables = [table.sort_values(joints) for table in tables]
    np.testing.assert_allclose(*tables, rtol=0, atol=1e-9)


def test_the_machine_travels_less_than_in_the_grids_order(plan, start, folder):
    table = read(plan("ups3_s", "--poses", "27", "--layout", "grid").out)
    plans = the_planner(start, folder, "ups3_s")
    u = planned(plans.workspace, plans.model.chain.tool_axes, Plan(poses=27, layout="grid"), 0)
    as_planned = plans.sites("grid", 27).readings
    np.testing.assert_allclose(np.sort(np.rad2deg(u[:, 3])), np.sort(table["planned_rx_deg"]), rtol=0, atol=1e-6)

    def travel(readings: np.ndarray) -> float:
        return float(np.abs(np.diff(readings, axis=0)).max(axis=1).sum())

    assert travel(table[["leg1_slide", "leg2_slide", "leg3_slide"]].to_numpy()) < travel(as_planned)


@pytest.mark.parametrize("name", ["plan.csv", "plan.parquet", "PLAN.CSV"])
def test_output_goes_to_a_file(plan, tmp_path, name):
    answer = plan("ups3_s", "--poses", "6", "--layout", "random", "--output", name)
    assert (answer.status, answer.out) == (0, "")
    written = pd.read_parquet(tmp_path / name) if name.endswith("parquet") else pd.read_csv(tmp_path / name)
    pd.testing.assert_frame_equal(written, read(plan("ups3_s", "--poses", "6", "--layout", "random").out))
    assert "exists already" in plan("ups3_s", "--poses", "7", "--output", name).err
    assert plan("ups3_s", "--poses", "7", "--layout", "random", "--output", name, "--force").status == 0
    again = pd.read_parquet(tmp_path / name) if name.endswith("parquet") else pd.read_csv(tmp_path / name)
    assert len(again) == 7


def test_a_plan_with_what_was_measured_beside_it_is_a_measurement_table(plan, start, folder, tmp_path):
    table = read(plan("ups3_s", "--poses", "6", "--layout", "random").out)
    table[["roll", "pitch"]] = 0.1
    table.to_csv(tmp_path / "measured.csv", index=False)
    description = start(folder)[0].robot.description
    found = read_table(tmp_path / "measured.csv", description.actuated, description.measure)
    assert list(found) == ["pose", *description.actuated, "roll", "pitch"]
    np.testing.assert_array_equal(found["leg3_slide"], table["leg3_slide"])


def test_determinism(plan):
    first, second = (plan("ups3_s", "--poses", "8") for _ in range(2))
    assert first.out == second.out
    assert plan("ups3_s", "--poses", "8", "--set", "seed=1").out != first.out


# What is said of it


def test_the_layouts_side_by_side(document):
    found = document("ups3_s", "--poses", "20")
    assert (found["robot"], found["layout"], found["n_poses"]) == ("ups3_s", "d_optimal", 20)
    assert found["channels"] == ["tilt", "yaw"]
    assert (found["wanted"], found["needed"]) == (None, None)
    assert len(found["poses"]) == 20
    assert {row["layout"] for row in found["layouts"]} == set(LAYOUTS)
    for row in found["layouts"]:
        assert set(row) == SCORE
        assert row["excited"] == row["excitable"] == 27
        assert row["condition_number"] == pytest.approx(1 / row["o2"])
        assert 0 < row["mean_deg"] < row["rms_deg"] < 0.003
        assert row["mean_deg"] < row["max_deg"]
        assert row["mean_mm"] is None
    best = max(found["layouts"], key=lambda row: row["o1"])
    assert best["layout"] == "d_optimal"
    assert min(found["layouts"], key=lambda row: row["max_deg"]) == best


def test_few_poses_have_no_condition_number(document):
    """Nine rows can't excite 27 directions."""
    for row in document("ups3_s", "--poses", "3", "--layout", "grid")["layouts"]:
        assert row["excited"] <= 9
        assert (row["condition_number"], row["o1"]) == (None, 0)


def test_a_small_table_on_stderr(plan):
    answer = plan("jugglebot", "--poses", "12", "--layout", "grid")
    lines = answer.err.splitlines()
    heading = next(k for k, line in enumerate(lines) if line.startswith("jugglebot: 12 poses"))
    assert "orientation, position" in lines[heading]
    for word in ("O1", "O5", "condition", "[deg]", "[mm]"):
        assert word in lines[heading + 2]
    assert [line.split()[0] for line in lines[heading + 3 : heading + 6]] == list(LAYOUTS)
    assert len(read(answer.out)) == 12


def test_a_stream_counts_as_the_mean_of_its_samples(document):
    options = ("ups3_s", "--poses", "15", "--layout", "random")
    streamed = document(*options)["layouts"][1]
    rows = document(*options, "--set", "measure.stream.seconds=20")["layouts"][1]
    assert rows["o3"] == pytest.approx(2 * streamed["o3"], rel=1e-6)
    assert rows["mean_deg"] < 0.75 * streamed["mean_deg"]


# How many poses are needed


def test_poses_for_an_accuracy(document, start, folder):
    """The fewest, among the numbers next to it; and without --poses the plan has as many."""
    found = document("ups3_s", "--accuracy", "0.001")
    assert found["wanted"] == {"mean_deg": 0.001, "mean_mm": None, "most": MOST}
    assert found["n_poses"] == found["needed"]["d_optimal"]
    plans = the_planner(start, folder, "ups3_s", 'measure.channels=["tilt", "yaw"]')
    for layout in LAYOUTS:
        n = found["needed"][layout]
        assert plans.accuracy(layout, n).mean_deg <= 0.001 < plans.accuracy(layout, n - 1).mean_deg, layout


def test_poses_for_two_accuracies(start, folder):
    """The harder of the two decides."""
    plans = the_planner(start, folder, "ur10", 'measure.channels=["orientation", "position"]')
    demands = (Wanted(deg=0.006), Wanted(mm=0.02), Wanted(0.006, 0.02))
    turned, moved, both = (plans.needed("random", wanted.met, 100) for wanted in demands)
    assert turned < moved == both


def test_an_accuracy_that_cannot_be_reached(plan, document, monkeypatch):
    monkeypatch.setattr("kincal.pipeline.planning.layouts.MOST", 20)
    few = ("ups3_s", "--accuracy", "1e-7", "--layout", "random")
    answer = plan(*few)
    assert (answer.status, answer.out) == (2, "")
    assert "1e-07 deg can't be reached with 20 poses of layout random" in answer.err.splitlines()[-1]
    assert set(document(*few, "--poses", "4")["needed"].values()) == {None}


# The stage


def test_d_optimal_poses_in_the_pipeline(start, tmp_path):
    """They depend on the instruments; the other layouts don't."""
    run, events = start(tmp_path, "plan.poses=10", "plan.layout=d_optimal")
    table = run.until("plan")[0].table
    assert len(table) == len(table.drop_duplicates(["leg1_slide", "leg2_slide", "leg3_slide"])) == 10
    assert [event.stage for event in events if event.state == "ran"] == ["model", "plan"]
    for changed, why in (
        ("sensor.orientation_deg=0.01", "setting instruments.sensor.orientation_deg 0.0006 -> 0.01"),
        ("tolerance.position_mm=1.0", "setting instruments.tolerance.position_mm 0.3 -> 1.0"),
        ('measure.channels=["tilt"]', "setting instruments.channels"),
    ):
        again, _ = start(tmp_path, "plan.poses=10", "plan.layout=d_optimal", changed)
        found = {stage: (state, why) for stage, state, why in again.status()}["plan"]
        assert found[0] == "stale"
        assert found[1].startswith(why)
    run, _ = start(tmp_path, "plan.poses=10", "plan.layout=random")
    run.until("plan")
    again, _ = start(tmp_path, "plan.poses=10", "plan.layout=random", "sensor.orientation_deg=0.01")
    assert {stage: state for stage, state, _ in again.status()}["plan"] == "fresh"
    assert "instruments" in all_stages()["plan"].settings


def test_a_robot_is_identified_from_d_optimal_poses(start, tmp_path):
    """Geometric errors alone: as accurate as predicted, within what one robot differs from the mean."""
    settings = ("plan.poses=20", "plan.layout=d_optimal", "measure.errors.elastic=false", "measure.errors.screw=false")
    run, _ = start(tmp_path, *settings)
    model, measured, identified = run.until("model", "measure", "identify")
    description = run.robot.description
    errors = ErrorModel.of(model.chain(), description.actuator, description.tolerance)
    plans = planner(description, model.chain())
    fresh = plans.sites("random", 200).readings
    truth, found = (errors.robot(p) for p in (measured.truth.p, identified.shipped.change))
    actual, predicted = (r.measured(r.close(fresh).pose) for r in (truth, found))
    mean = score(actual, predicted, ("orientation",)).mean_deg
    assert 0.4 < mean / plans.accuracy("d_optimal", 20).mean_deg < 2.0


# Bad input


@pytest.mark.parametrize(
    "options, said",
    [
        (["--poses", "2"], ["2 poses", "3"]),
        (["--poses", "0"], ["0 poses", "3"]),
        (["--poses", "-4"], ["-4 poses"]),
        (["--poses", "100000"], ["100000 poses", "1000"]),
        (["--poses", "many"], ["--poses", "many"]),
        (["--layout", "d-optimal"], ["--layout", "d-optimal"]),
        (["--layout", "best"], ["--layout", "best"]),
        (["--accuracy", "0"], ["--accuracy 0", "greater than 0"]),
        (["--accuracy", "nan"], ["--accuracy nan"]),
        (["--accuracy-mm", "-1"], ["--accuracy-mm -1"]),
        (["--accuracy-mm", "0.1"], ["--accuracy-mm", "position is not measured", "measure.channels"]),
        (["--output", "plan.txt"], ["plan.txt", ".csv"]),
        (["--output", "no/such/folder/plan.csv", "--poses", "3", "--layout", "random"], ["no/such/folder"]),
        (["--set", "plan.layout=best"], ["plan.layout", "d_optimal"]),
    ],
)
def test_bad_input(plan, options, said):
    """One line that says what is wrong; status 2."""
    answer = plan("ups3_s", *options)
    assert answer.status == 2
    assert answer.out == ""
    complaints = [line for line in answer.err.splitlines() if line.startswith("kincal: ")]
    assert len(complaints) == 1
    assert "Traceback" not in answer.err
    for text in said:
        assert text in complaints[0]
