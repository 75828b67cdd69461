"""The command `kincal`, as a user meets it."""

import io
import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.pipeline.commands.app import app
from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.virtual.robot import VirtualRobot

SET = ("--set", "plan.poses=12")
LINEAR = ("plan.poses=12", "measure.errors.elastic=false", "measure.errors.screw=false")
COMMANDS = ("run", "inspect", "compare", "status")
QUATERNION = ["qx", "qy", "qz", "qw"]
SCORE = {"name", "mean_deg", "max_deg", "sd_deg", "axis_mean_deg", "mean_mm", "max_mm", "sd_mm"}


def flags(settings: tuple[str, ...]) -> list[str]:
    return [part for setting in settings for part in ("--set", setting)]


def document(answer):
    """The one JSON document on stdout."""
    assert answer.status == 0, answer.err
    assert "Traceback" not in answer.err
    return json.loads(answer.out, parse_constant=lambda constant: pytest.fail(f"{constant} is no JSON"))


def check_comparison(found: dict) -> None:
    assert {"robot", "n_poses", "scored_on", "methods", "held_out"} <= set(found)
    assert [m["name"] for m in found["methods"]] == list(METHODS)
    for method in (*found["methods"], *found["held_out"]):
        assert set(method) >= SCORE
        assert set(method["axis_mean_deg"]) == set("xyz")


# Real processes


def test_a_first_run_and_its_questions(kincal, finished):
    """run, then the other commands from the cache; the numbers are those of the library."""
    ran = kincal("run", "ups3_s", *SET, "--json")
    check_comparison(document(ran))
    assert "ups3_s model      ran" in ran.err
    assert finished.agrees(document(ran)["methods"][1]["mean_deg"])
    compared, first = document(kincal("compare", "ups3_s", *SET, "--json")), document(ran)
    assert compared.pop("provenance")["inputs"] == first.pop("provenance")["inputs"]
    assert compared == first
    assert {row["state"] for row in document(kincal("status", "ups3_s", *SET, "--json"))} == {"fresh"}


def test_exit_statuses(kincal, store):
    assert kincal("compare", "ups3_s", *SET, "--store", store).status == 0
    failed = kincal("run", "ups3_s", *SET, "--set", "identify.max_iterations=1", "--store", store)
    assert failed.status == 1
    assert "did not converge" in failed.err.splitlines()[-1]
    assert "Traceback" not in failed.err
    assert kincal("run", "no_such_robot", "--store", store).status == 2


HEAVY = ("torch", "casadi", "pinocchio", "pandas", "matplotlib", "scipy.optimize")
LOOK = """
import sys
from kincal.pipeline.commands.app import main
try:
    main(sys.argv[1:])
except SystemExit as left:
    code = left.code
print([name for name in {heavy} if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""


@pytest.mark.parametrize("command", [*COMMANDS, "--help", "--version", "compare --help"])
def test_what_is_not_needed_is_not_imported(finished, store, tmp_path, environment, command):
    arguments = (
        [command, "ups3_s", *flags(finished.settings), "--store", store] if command in COMMANDS else command.split()
    )
    done = subprocess.run(
        [sys.executable, "-c", LOOK.format(heavy=HEAVY), *map(str, arguments)],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == "[]"


def test_identification_does_not_import_torch(tmp_path, environment):
    done = subprocess.run(
        [sys.executable, "-c", LOOK.format(heavy=("torch",)), "run", "ups3_s", *SET, "--until", "identify"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr.splitlines()[-1]) == (0, "[]")


def test_a_pipe_that_closes_early(finished, store, tmp_path, environment):
    arguments = ["inspect", "ups3_s", *flags(finished.settings), "--store", str(store)]
    command = [sys.executable, "-m", "kincal", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, env=environment(), stdout=pipe, stderr=pipe, text=True) as process:
        process.stdout.close()
        said = process.stderr.read()
    assert "Traceback" not in said
    assert "Exception" not in said


# The documents


def test_compare(cli, store, finished):
    found = document(cli("compare", "ups3_s", *SET, "--store", store, "--json"))
    check_comparison(found)
    assert (found["robot"], found["n_poses"], found["scored_on"]) == ("ups3_s", 12, "fresh")
    assert found["n_scored"] >= 500
    assert [m["name"] for m in found["held_out"]] == list(METHODS)
    assert found["methods"][1]["mean_deg"] == finished.comparison.methods[1].mean_deg
    assert found["methods"][1]["mean_mm"] is None


def test_some_of_the_measured_poses(cli, store):
    """split.poses: as many are used, by every method; and no more than there are."""
    options = ("compare", "ups3_s", *SET, "--store", store, "--json", "--set")
    found = document(cli(*options, "split.poses=9"))
    check_comparison(found)
    assert (found["n_poses"], found["advice"]["n_poses"]) == (9, 9)
    refused = cli(*options, "split.poses=13")
    assert (refused.status, refused.out) == (2, "")
    assert refused.err.splitlines()[-1].endswith("split.poses = 13: there are 12 measured poses")


def test_compare_several_robots(cli, store, robot_folder):
    found = document(cli("compare", "ups3_s", robot_folder, *SET, "--store", store, "--json"))
    assert isinstance(found, list)
    assert len(found) == 2
    changes = found[1].pop("changes")
    assert found[0] == found[1]
    assert (changes["changed"], changes["chi_square"]) == (False, 0.0)


def test_run_with_json_is_compare(cli, store):
    arguments = ("ups3_s", *SET, "--store", store, "--json")
    assert document(cli("run", *arguments)) == document(cli("compare", *arguments))


def test_inspect(cli, store):
    found = document(cli("inspect", "ups3_s", *SET, "--store", store, "--json"))
    assert {"robot", "rank", "n_parameters", "condition_number", "parameters", "unobservable"} <= set(found)
    assert len(found["parameters"]) == found["n_parameters"] > found["rank"]
    for parameter in found["parameters"]:
        assert {"name", "unit", "nominal", "identified", "change", "std", "low", "high", "identifiable"} <= set(
            parameter
        )
        assert parameter["identified"] == pytest.approx(parameter["nominal"] + parameter["change"], abs=1e-15)
        if parameter["std"] is not None:
            assert parameter["low"] <= parameter["identified"] <= parameter["high"]


def test_status(cli, store, stage_names):
    found = document(cli("status", "ups3_s", *SET, "--store", store, "--json"))
    assert [row["stage"] for row in found] == list(stage_names)
    assert {row["state"] for row in found} == {"fresh"}


@pytest.mark.parametrize("command", COMMANDS)
def test_what_people_read(cli, store, command):
    """Tables on stdout, progress on stderr."""
    answer = cli(command, "ups3_s", *SET, "--store", store)
    assert answer.status == 0
    for word in {"status": ["evaluate", "fresh"], "inspect": ["Verdict: ", "in tolerances"]}.get(command, METHODS):
        assert word in answer.out
    assert "cached" not in answer.out


def test_until_stops_there(cli, tmp_path, stage_names):
    answer = cli("run", "ups3_s", *SET, "--until", "plan")
    assert (answer.status, answer.out) == (0, "")
    assert sorted(f.name for f in (tmp_path / ".kincal" / "artifacts").iterdir()) == ["model", "plan"]
    said = json.loads(cli("run", "ups3_s", *SET, "--until", "plan", "--json").out)
    assert (said["robot"], said["stage"]) == ("ups3_s", "plan")
    assert list(said["provenance"]["inputs"]) == ["model", "plan"]


def test_help_names_every_command(cli):
    answer = cli("--help")
    assert answer.status == 0
    for command in ("run", "inspect", "compare", "status", "predict", "evaluate"):
        assert command in answer.out
        assert cli(command, "--help").status == 0
    assert app.name[0] == "kincal"


# predict


@pytest.fixture(scope="module")
def linear(start, tmp_path_factory):
    """A robot with geometric errors alone: (store, run, its stages' results)."""
    store = tmp_path_factory.mktemp("linear") / "store"
    run, _ = start(store, *LINEAR)
    return store, run, run.until("model", "plan", "measure", "identify")


def predicted(answer) -> pd.DataFrame:
    assert answer.status == 0, answer.err
    return pd.read_csv(io.StringIO(answer.out))


def error_model(run, model) -> ErrorModel:
    description = run.robot.description
    return ErrorModel.of(model.chain(), description.actuator, description.tolerance)


@pytest.mark.parametrize("method", ["nominal", "geometric"])
def test_predict_is_the_error_model(cli, linear, tmp_path, method):
    store, run, (model, plan, _, identified) = linear
    plan.table.to_csv(tmp_path / "joints.csv", index=False)
    found = predicted(
        cli("predict", "ups3_s", *flags(LINEAR), "--store", store, "--joints", "joints.csv", "--method", method)
    )
    p = {"nominal": identified.registered, "geometric": identified.shipped.change}[method]
    robot = error_model(run, model).robot(p)
    expected = robot.measured(robot.close(plan.table[list(run.robot.description.actuated)].to_numpy()).pose)
    turned = Rotation.from_quat(found[QUATERNION].to_numpy()).inv() * Rotation.from_matrix(expected.rotation)
    assert turned.magnitude().max() < 1e-12
    assert list(found["pose"]) == list(plan.table["pose"])
    assert ("orientation_std" in found) == ("orientation_95" in found) == (method == "geometric")
    assert "share" not in found


def test_the_truth_is_predicted_within_its_sigmas(cli, linear, tmp_path):
    """On the plan, of a robot whose errors are all geometric."""
    store, run, (model, plan, measured, _) = linear
    plan.table.to_csv(tmp_path / "joints.csv", index=False)
    found = predicted(cli("predict", "ups3_s", *flags(LINEAR), "--store", store, "--joints", "joints.csv"))
    readings = plan.table[list(run.robot.description.actuated)].to_numpy()
    truth = VirtualRobot.of(error_model(run, model), measured.truth).pose(readings)
    error = (Rotation.from_quat(found[QUATERNION].to_numpy()).inv() * Rotation.from_matrix(truth.rotation)).as_rotvec()
    ratio = np.sqrt(np.mean(error**2, axis=1)) / found["orientation_std"]
    assert 0.2 < np.sqrt(np.mean(ratio**2)) < 2.0
    assert ratio.max() < 4.0
    assert np.mean(np.linalg.norm(error, axis=1) < found["orientation_95"]) >= 0.75  # of twelve


def test_predict_by_hybrid(cli, store, finished, tmp_path):
    """How sure it is, and how much of the correction is believed: 0 where nothing was measured, as by geometric."""
    inside, outside = finished.table.head(4), finished.table.head(1).copy()
    outside[["leg1_slide", "leg2_slide", "leg3_slide"]] += 0.08
    pd.concat([inside, outside]).assign(pose=range(5)).to_csv(tmp_path / "joints.csv", index=False)
    options = ("predict", "ups3_s", *SET, "--store", store, "--joints", "joints.csv", "--method")
    found, geometric = (predicted(cli(*options, name)) for name in ("hybrid", "geometric"))
    assert list(found) == ["pose", *QUATERNION, "orientation_std", "orientation_95", "share"]
    assert list(geometric) == [name for name in found if name != "share"]
    assert found["share"].between(0, 1).all()
    assert found["share"].iloc[4] == 0
    pd.testing.assert_frame_equal(found.iloc[4:, :-1], geometric.iloc[4:])
    for table in (found, geometric):
        assert np.all(table["orientation_95"] > 2.5 * table["orientation_std"])
        assert np.all(table["orientation_95"] < 3.5 * table["orientation_std"])
        assert table["orientation_std"].iloc[4] > table["orientation_std"].iloc[:4].max()


@pytest.mark.parametrize("method", ["nominal", "network", "transfer", "transfer_identified"])
def test_methods_that_do_not_say_how_sure_they_are(cli, store, finished, tmp_path, method):
    finished.table.to_csv(tmp_path / "joints.csv", index=False)
    found = predicted(cli("predict", "ups3_s", *SET, "--store", store, "--joints", "joints.csv", "--method", method))
    assert list(found) == ["pose", *QUATERNION]


def test_predict_as_json(cli, store, finished, tmp_path):
    finished.table.to_csv(tmp_path / "joints.csv", index=False)
    options = ("ups3_s", *SET, "--store", store, "--joints", "joints.csv")
    found = document(cli("predict", *options, "--json"))
    table = predicted(cli("predict", *options))
    assert [set(row) for row in found] == [set(table.columns)] * len(table)
    assert [row["qx"] for row in found] == pytest.approx(list(table["qx"]), abs=1e-12)


def test_predict_takes_joint_values_alone(cli, store, finished, tmp_path):
    """No pose numbers, nothing measured; Parquet as well as CSV."""
    joints = finished.table[["leg3_slide", "leg1_slide", "leg2_slide"]]
    joints.to_csv(tmp_path / "joints.csv", index=False)
    joints.to_parquet(tmp_path / "joints.parquet")
    options = ("predict", "ups3_s", *SET, "--store", store, "--joints")
    pd.testing.assert_frame_equal(predicted(cli(*options, "joints.csv")), predicted(cli(*options, "joints.parquet")))


# evaluate


def evaluated(cli, store, table: pd.DataFrame, tmp_path, *options: str) -> dict:
    table.to_csv(tmp_path / "data.csv", index=False)
    found = document(cli("evaluate", "ups3_s", *SET, "--store", store, "--data", "data.csv", "--json", *options))
    check_comparison(found)
    assert found["scored_on"].endswith("data.csv")
    return {m["name"]: m["mean_deg"] for m in found["methods"]}


def test_geometric_beats_nominal_on_its_own_table(cli, store, finished, tmp_path):
    found = evaluated(cli, store, finished.table, tmp_path)
    assert found["geometric"] < 0.1 * found["nominal"]


@pytest.mark.parametrize("rotation_vector", [(0.1, -0.2, 0.5), (0.0, 2.0, 0.5)])
def test_an_instrument_set_up_anew_is_registered(cli, store, finished, tmp_path, rotation_vector):
    before = evaluated(cli, store, finished.table, tmp_path)
    moved = finished.table.copy()
    turned = Rotation.from_rotvec(rotation_vector) * Rotation.from_quat(moved[QUATERNION].to_numpy())
    moved[QUATERNION] = turned.as_quat()
    assert evaluated(cli, store, moved, tmp_path)["geometric"] > 10
    found = evaluated(cli, store, moved, tmp_path, "--register")
    assert found["geometric"] == pytest.approx(before["geometric"], rel=0.3)
    assert found["nominal"] == pytest.approx(before["nominal"], rel=0.3)


def test_half_a_turn_is_not_called_accurate(cli, store, finished, tmp_path):
    """The error of a small rotation is the vector of its matrix's skew part; of half a turn that is zero."""
    moved = finished.table.copy()
    moved[QUATERNION] = (Rotation.from_rotvec((np.pi, 0, 0)) * Rotation.from_quat(moved[QUATERNION])).as_quat()
    assert evaluated(cli, store, moved, tmp_path)["geometric"] > 90


def test_a_robot_homed_anew_is_rehomed(cli, store, finished, tmp_path):
    before = evaluated(cli, store, finished.table, tmp_path)
    moved = finished.table.copy()
    moved["leg2_slide"] += 0.5e-3
    assert evaluated(cli, store, moved, tmp_path)["geometric"] > 0.05
    assert evaluated(cli, store, moved, tmp_path, "--rehome")["geometric"] < 1.5 * before["geometric"]


def test_evaluate_with_a_column_map(cli, store, finished, tmp_path):
    """The same numbers under foreign names and in other units."""
    plain = evaluated(cli, store, finished.table, tmp_path)
    foreign = finished.table.rename(columns={"leg1_slide": "Leg 1 (mm)", "qx": "i"})
    foreign["Leg 1 (mm)"] *= 1000
    (tmp_path / "columns.toml").write_text('leg1_slide = { from = "Leg 1 (mm)", unit = "mm" }\nqx = "i"\n')
    found = evaluated(cli, store, foreign, tmp_path, "--columns", "columns.toml")
    assert found == pytest.approx(plain, rel=1e-6)


def test_too_few_poses_to_register(cli, store, finished, tmp_path):
    finished.table.head(2).to_csv(tmp_path / "data.csv", index=False)
    answer = cli("evaluate", "ups3_s", *SET, "--store", store, "--data", "data.csv", "--register")
    assert (answer.status, answer.out) == (2, "")
    assert "2 poses" in answer.err.splitlines()[-1]
