"""Robots, plans and identification as values: in memory, without files and without a store."""

import json
import logging

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kincal
from kincal.pipeline.virtual.robot import draw

GEOMETRIC = {f"measure.errors.{name}": False for name in ("elastic", "screw")}


@pytest.fixture(scope="module")
def robot():
    return kincal.load("ups3_s", {"plan.poses": 30})


@pytest.fixture(scope="module")
def data(robot):
    return kincal.measure(robot, seed=3)


@pytest.fixture(scope="module")
def fit(robot, data):
    return kincal.identify(robot, data)


def test_settings_are_those_of_the_command_line():
    by_key = kincal.load("ups3_s", {"plan.poses": 60, "measure.channels": ["orientation"], "seed": np.int64(4)})
    nested = kincal.load("ups3_s", {"plan": {"poses": 60}, "measure": {"channels": ("orientation",)}, "seed": 4})
    texts = kincal.load("ups3_s", ["plan.poses=60", 'measure.channels=["orientation"]', "seed=4"])
    assert by_key.description == nested.description == texts.description
    assert by_key.description.plan.poses == 60
    assert "ups3_s" in repr(by_key)
    assert "plan.poses=60" in repr(by_key)


@given(
    st.one_of(
        st.integers(-(2**60), 2**60),
        st.floats(allow_nan=False, allow_infinity=False),
        st.booleans(),
        st.text(max_size=20),
        st.lists(st.integers(-9, 9), max_size=4),
    )
)
def test_a_value_in_toml_comes_back(value):
    import tomllib

    from kincal.urdf.toml_values import as_toml

    assert tomllib.loads(f"value = {as_toml(value, 'value')}")["value"] == value


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("no_such_robot",), "robot 'no_such_robot': neither a file nor a shipped robot"),
        ((7,), "robot: found a int; allowed are a name, a path, or FLEET.toml:UNIT"),
        (("ups3_s", {"plan.pose": 3}), "--set plan.pose=3: plan.pose: unknown key; did you mean 'poses'?"),
        (("ups3_s", {"plan.poses": "many"}), "plan.poses: found 'many'"),
        (("ups3_s", {"plan.poses": None}), "settings: plan.poses: found None; allowed is a number"),
        (("ups3_s", "plan.poses=3"), "settings: allowed are a dictionary"),
        (("ups3_s", [3]), "settings: allowed are a dictionary"),
    ],
)
def test_a_robot_that_cannot_be_loaded(arguments, message):
    with pytest.raises(kincal.InputError) as error:
        kincal.load(*arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_table_is_measured_without_a_store(robot, data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    again = kincal.measure(robot, seed=3)
    pd.testing.assert_frame_equal(data, again)
    assert not data.equals(kincal.measure(robot, seed=4))
    assert len(data) == 30
    assert {"pose", "leg1_slide", "roll", "pitch", "tilt_std"} <= set(data)
    assert list(tmp_path.iterdir()) == []


def test_a_real_robot_can_be_measured_virtually():
    data = kincal.measure(kincal.load("jugglebot", {"plan.poses": 12}), seed=0)
    assert len(data) == 12
    assert {"x", "y", "z", "qw"} <= set(data)


def test_the_identification_finds_the_truth():
    """Purely geometric errors: every parameter's error is within what its sigma says."""
    robot = kincal.load("ups3_s", {"plan.poses": 60, **GEOMETRIC})
    fit = kincal.identify(robot, kincal.measure(robot, seed=5))
    from kincal.identification.error_model import ErrorModel
    from kincal.pipeline.run.in_memory import InMemory

    description = robot.description
    model = ErrorModel.of(InMemory(description).result("model").chain(), description.actuator, description.tolerance)
    truth = pd.Series(draw(model, description.measure.errors, 5).p, index=pd.Index(model.parameters.names))
    # a sigma that is infinite says nothing, and W and T take up what the frames' convention leaves
    known = fit.parameters[fit.parameters["std"].notna() & fit.parameters["identifiable"]]
    apart = (known["change"] - truth[known.index]) / known["std"]
    assert len(known) > 3
    assert np.abs(apart).max() < 4.5


def test_a_fit_is_the_document_of_inspect(fit, cli, data, tmp_path):
    data.to_csv(tmp_path / "poses.csv", index=False)
    answer = cli("inspect", "ups3_s", "--set", "plan.poses=30", "--set", "measure.table=poses.csv", "--json")
    assert answer.status == 0, answer.err
    document = json.loads(answer.out)
    assert (document.pop("schema"), document["virtual"]) == ("kincal-identification-1", False)
    del document["provenance"]
    ours = fit.to_dict()
    assert document.keys() == ours.keys()
    for theirs, (name, row) in zip(document["parameters"], fit.parameters.iterrows(), strict=True):
        assert theirs["name"] == name
        assert theirs["change"] == pytest.approx(row["change"], rel=1e-6, abs=1e-10)
    assert document["findings"] == list(fit.findings)


def test_tables_of_a_fit(fit):
    table = fit.parameters
    assert list(table.columns[:8]) == [
        "unit", "nominal", "identified", "change", "std", "low", "high", "identifiable",
    ]  # fmt: skip
    assert table["identifiable"].dtype == bool
    assert table["change"].dtype == float
    np.testing.assert_allclose(table["identified"] - table["nominal"], table["change"], atol=1e-12)
    known = table["std"].notna()
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[known], table["std"][known], rtol=1e-12)
    assert list(fit.covariance.index) == list(fit.covariance.columns) == list(table.index)
    assert list(fit.outliers.columns) == ["pose", "reason"]
    assert isinstance(fit.findings, tuple)
    assert all(isinstance(line, str) for line in fit.unobservable)
    assert "30 poses" in repr(fit)


def test_an_outlier_is_a_row(robot, data):
    spoiled = data.copy()
    spoiled.loc[7, "roll"] += 0.002
    fit = kincal.identify(kincal.load("ups3_s", {"plan.poses": 30, "identify.loss": "cauchy"}), spoiled)
    assert 7 in fit.outliers["pose"].tolist()


def test_the_same_from_a_frame_and_from_files(robot, data, fit, tmp_path):
    data.to_csv(tmp_path / "poses.csv", index=False)
    data.to_parquet(tmp_path / "poses.parquet")
    by_index = data.set_axis(np.arange(len(data)) + 100)
    for table in (tmp_path / "poses.csv", str(tmp_path / "poses.parquet"), by_index, data[data.columns[::-1]]):
        again = kincal.identify(robot, table)
        pd.testing.assert_frame_equal(again.parameters, fit.parameters)


def test_a_frame_is_left_as_it_was(robot, data):
    before = data.copy()
    kincal.identify(robot, data)
    pd.testing.assert_frame_equal(data, before)


BAD_TABLES = [
    (lambda t: [1, 2, 3], "data: found a list; allowed are a DataFrame, or the path of a CSV, Parquet or Excel file"),
    (lambda t: t.drop(columns="leg2_slide"), "the DataFrame: column 'leg2_slide' (leg2_slide) is missing; it has pose"),
    (lambda t: t.drop(columns="roll"), "the DataFrame: it has pitch, but not roll; allowed is all of them or none"),
    (lambda t: t[["pose", "leg1_slide", "leg2_slide", "leg3_slide"]], "the DataFrame: nothing was measured"),
    (lambda t: t.head(0), "the DataFrame: the table is empty"),
    (lambda t: t.assign(roll=np.nan), "the DataFrame: column 'roll', row 1: found nan; allowed are finite numbers"),
    (lambda t: t.assign(roll="tilted"), "the DataFrame: column 'roll', row 1: found 'tilted'"),
    (lambda t: t.assign(pose=0), "the DataFrame: pose 0 appears twice (row 2)"),
    (lambda t: t.assign(leg1_slide=500.0), "the DataFrame: pose 0: joint 'leg1_slide' would be at 500 m"),
    (lambda t: pd.concat([t, t["roll"]], axis=1), "the DataFrame: column 'roll' appears twice"),
    (lambda t: t.head(2), "poses"),
    (lambda t: "absent.csv", "absent.csv"),
]


@pytest.mark.parametrize("spoil, message", BAD_TABLES)
def test_a_table_that_cannot_be_used(robot, data, spoil, message):
    """One line that names the table, the column and the row, from `identify` and from `calibrate`."""
    for call in (kincal.identify, kincal.calibrate):
        with pytest.raises(kincal.InputError) as error:
            call(robot, spoil(data))
        assert message in str(error.value)
        assert "\n" not in str(error.value)


def test_a_fit_that_fails_is_refused(robot, data):
    with pytest.raises(kincal.CalibrationError, match="did not converge"):
        kincal.identify(kincal.load("ups3_s", {"identify.max_iterations": 1}), data)


def test_a_plan_is_a_table(robot, tmp_path):
    plan = kincal.plan(robot, poses=14, layout="random", output=tmp_path / "plan.csv")
    assert len(plan) == len(plan.poses) == 14
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "plan.csv"), plan.poses)
    assert list(plan.layouts.index) == ["grid", "random", "d_optimal"]
    assert (plan.layouts["mean_deg"] > 0).all()
    assert plan.needed == {}
    with pytest.raises(kincal.InputError, match="exists already"):
        plan.save(tmp_path / "plan.csv")
    wanted = kincal.plan(robot, accuracy_deg=0.01, layout="grid")
    assert wanted.needed["grid"] == len(wanted)


def test_what_a_plan_will_show(robot):
    foresight = kincal.foresee(robot)
    assert foresight.parameters["std"].notna().any()
    assert "identified" not in foresight.parameters
    assert any("no effect" in line for line in foresight.unobservable)


def test_progress_is_told(robot, data):
    events = []
    kincal.identify(robot, data, progress=events.append)
    assert [(e.stage, e.state) for e in events] == [
        ("model", "running"), ("model", "ran"), ("filter", "running"), ("filter", "ran"),
    ]  # fmt: skip


def test_what_the_data_say_is_logged(capfd, caplog, robot):
    """By one logger, which says nothing on its own account."""
    events = kincal.Event("measure", "noted", "12 samples were left out")
    from kincal.pipeline.interface.progress import stage_observer

    with caplog.at_level(logging.DEBUG, logger="kincal"):
        stage_observer(False, "ups3_s")(events)
    assert caplog.record_tuples == [("kincal.pipeline", logging.WARNING, "12 samples were left out")]
    kincal.identify(robot)
    said = capfd.readouterr()
    assert said.out == ""
    assert "ups3_s" not in said.err


@pytest.mark.parametrize(
    "spoil, column, row",
    [
        (lambda t: t.drop(columns="leg2_slide"), "leg2_slide", None),
        (lambda t: t.assign(roll=t["roll"].where(t["pose"] != 4)), "roll", 4),
        (lambda t: t.assign(tilt_std=-1.0), "tilt_std", 0),
        (lambda t: t.assign(leg3_slide=9.0), "leg3_slide", 0),
        (lambda t: t.head(0), None, None),
    ],
)
def test_a_table_error_says_where(robot, data, spoil, column, row):
    with pytest.raises(kincal.TableError) as error:
        kincal.identify(robot, spoil(data))
    assert (error.value.column, error.value.row) == (column, row)


def test_other_errors_carry_what_a_caller_can_act_on(robot, data):
    with pytest.raises(kincal.UnknownNameError) as unknown:
        kincal.load("ups3")
    assert "ups3_s" in unknown.value.allowed
    with pytest.raises(kincal.NotConvergedError):
        kincal.identify(kincal.load("ups3_s", {"identify.max_iterations": 1}), data)
