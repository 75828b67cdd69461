"""All stages from Python: the same results as the command line, from tables that may be values."""

import gc
import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import kincal
from benchmarks.small import SMALL
from kincal.pipeline.interface.cache import collect

QUICK = (*SMALL, 'measure.channels=["tilt", "yaw"]', "plan.poses=24")
FLAGS = [part for text in QUICK for part in ("--set", text)]


@pytest.fixture(scope="module")
def robot():
    return kincal.load("ups3_s", QUICK)


@pytest.fixture(scope="module")
def data(robot):
    return kincal.measure(robot, seed=3)


@pytest.fixture(scope="module")
def calibration(robot, data, tmp_path_factory):
    return kincal.calibrate(robot, data, store=tmp_path_factory.mktemp("store"))


def payloads(store) -> dict[str, list[str]]:
    """{stage/file: its digests}, of all artifacts."""
    found: dict[str, list[str]] = {}
    for manifest in store.glob("artifacts/*/*/manifest.json"):
        for name, sealed in json.loads(manifest.read_text())["files"].items():
            found.setdefault(f"{manifest.parent.parent.name}/{name}", []).append(sealed["sha256"])
    return {name: sorted(digests) for name, digests in found.items()}


BOTH_WAYS = """
import sys, kincal
kincal.calibrate(kincal.load("ups3_s", sys.argv[2:]), store=sys.argv[1]).report()
"""


def test_the_command_and_the_library_make_the_same_bytes(kincal, tmp_path, environment):
    """Though a Python process has as many threads as cores until a stage runs."""
    assert kincal("run", "ups3_s", *FLAGS, "--store", "command").status == 0
    call = [sys.executable, "-c", BOTH_WAYS, "library", *QUICK]
    subprocess.run(call, cwd=tmp_path, env=environment(), capture_output=True, check=True)
    assert len(payloads(tmp_path / "command")) > 12
    assert payloads(tmp_path / "command") == payloads(tmp_path / "library")


def test_a_second_time_nothing_runs(robot, data, calibration):
    events = []
    again = kincal.calibrate(robot, data.copy(), store=calibration.store, progress=events.append)
    assert {event.state for event in events} == {"cached"}
    pd.testing.assert_frame_equal(again.compare(), calibration.compare())
    fresh = again.status().set_index("stage")["state"]
    assert (fresh.drop("report") == "fresh").all()


def test_without_a_store_nothing_is_left(robot, data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration = kincal.calibrate(robot, data)
    folder = calibration.store
    assert folder.is_dir()
    del calibration
    gc.collect()
    assert not folder.exists()
    assert list(tmp_path.iterdir()) == []


def test_the_comparison_is_that_of_the_command(calibration, robot, data, cli, tmp_path):
    data.to_parquet(tmp_path / "poses.parquet", index=False)  # to the last bit, which CSV is not
    answer = cli("compare", "ups3_s", *FLAGS, "--set", "measure.table=poses.parquet", "--json")
    assert answer.status == 0, answer.err
    table = calibration.compare()
    assert table.index.tolist() == [row["name"] for row in json.loads(answer.out)["methods"]]
    for row in json.loads(answer.out)["methods"]:
        assert row["mean_deg"] == pytest.approx(table.loc[row["name"], "mean_deg"], rel=1e-6)
        assert row["axis_mean_deg"]["x"] == pytest.approx(table.loc[row["name"], "x_deg"], rel=1e-6)
    assert table["mean_mm"].isna().all()
    assert calibration.advice.count("\n") == 0
    assert calibration.comparison.n_poses == 24


def test_predictions_from_every_kind_of_table(calibration, data, tmp_path):
    joints = ["leg1_slide", "leg2_slide", "leg3_slide"]
    table = data[["pose", *joints]]
    table.to_csv(tmp_path / "joints.csv", index=False)
    found = calibration.predict(table)
    pd.testing.assert_frame_equal(found, calibration.predict(table[joints].to_numpy()))
    pd.testing.assert_frame_equal(found, calibration.predict(tmp_path / "joints.csv"))
    assert {"roll", "pitch", "yaw", "tilt_std", "tilt_95", "share"} <= set(found)
    # the robot that measured these poses: what is predicted is what was measured, to some sigmas
    assert np.abs(found["roll"] - data["roll"]).max() < 1e-3
    assert len(calibration.predict(table[joints].to_numpy()[0])) == 1


def test_commands_reach_what_they_should(calibration, data):
    """Predicting the command gives the desired pose back."""
    desired = data[["pose", "roll", "pitch", "yaw"]].iloc[:6]
    commands = calibration.compensate(desired)
    assert commands["reached"].all()
    assert (commands["obstacle"] == "").all()
    there = calibration.predict(commands[["pose", "leg1_slide", "leg2_slide", "leg3_slide"]])
    np.testing.assert_allclose(there[["roll", "pitch", "yaw"]], desired[["roll", "pitch", "yaw"]], atol=1e-8)


def test_a_pose_that_cannot_be_reached_is_a_row(calibration, data):
    desired = data[["pose", "roll", "pitch", "yaw"]].iloc[:3].copy()
    desired.loc[1, "roll"] = 1.4
    commands = calibration.compensate(desired)
    assert commands["reached"].tolist() == [True, False, True]
    assert commands.loc[1, "obstacle"].startswith("pose 1 ")
    assert commands.loc[1, ["leg1_slide", "leg2_slide", "leg3_slide"]].isna().all()
    with pytest.raises(kincal.InputError, match="pose 1 "):
        calibration.compensate(desired, strict=True)


def test_another_day(calibration, robot, data):
    """The same robot, a fresh campaign: with W moved it fits only once W is registered anew."""
    moved = data.assign(yaw=data["yaw"] + 0.02)
    there = calibration.evaluate(moved).loc["geometric", "mean_deg"]
    registered = calibration.evaluate(moved, register=True).loc["geometric", "mean_deg"]
    assert there == pytest.approx(np.rad2deg(0.02), rel=0.05)
    assert registered < 0.05 * there
    whole = calibration.evaluation(moved, register=True)
    assert whole.scored_on == "the DataFrame"
    assert whole.n_scored == 24


BAD_CALLS = [
    (lambda c, d: c.predict(np.zeros((3, 2))), "readings: found an array of shape (3, 2); allowed is (n, 3)"),
    (lambda c, d: c.predict([0.5, 0.5, 0.5]), "readings: found a list; allowed are a DataFrame, or the path"),
    (lambda c, d: c.predict(d.drop(columns="leg1_slide")), "column 'leg1_slide' (leg1_slide) is missing"),
    (lambda c, d: c.predict(np.full((1, 3), np.nan)), "the array: column 'leg1_slide', row 1: found nan"),
    (lambda c, d: c.predict(d, method="hybird"), "--method hybird: no such method; did you mean 'hybrid'?"),
    (lambda c, d: c.compensate(d[["pose"]]), "the DataFrame: nothing was measured"),
    (lambda c, d: c.evaluate(d.head(1), register=True), "1 poses can't register an instrument"),
    (lambda c, d: c.evaluate({"pose": [1]}), "data: found a dict; allowed are a DataFrame"),
    (lambda c, d: c.export("out", format="stl"), "--format stl: no such format; "),
    (lambda c, d: c.export("out", method="hybrid"), "--method hybrid: --format urdf has none"),
    (lambda c, d: c.report("no/such/folder/report.html"), "report no/such/folder/report.html: can't be written"),
    (lambda c, d: c.until("identity"), "stage 'identity' does not exist; allowed: model"),
]


@pytest.mark.parametrize("call, message", BAD_CALLS)
def test_a_call_that_cannot_be_answered(calibration, data, call, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kincal.InputError) as error:
        call(calibration, data)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_what_is_handed_out(calibration, tmp_path):
    """A calibrated robot that can be loaded again, a document, and a page that names the table."""
    exported = calibration.export(tmp_path / "out", format="urdf")
    assert exported.position < 1e-9
    assert kincal.load(exported.path).description.name == "ups3_s"
    document = calibration.export(format="json").document
    assert document["schema"].startswith("kincal-calibration")
    page = calibration.report(tmp_path / "report.html").read_text()
    assert "dataframe-" in page
    assert kincal.__version__ in page
    assert document["provenance"]["versions"]["kincal"] == kincal.__version__


def test_a_table_stays_while_it_is_needed(robot, data, tmp_path):
    store = tmp_path / "store"
    calibration = kincal.Calibration.open(robot, data, store=store)
    (table,) = (store / "tables").iterdir()
    pd.testing.assert_frame_equal(pd.read_parquet(table), data[pd.read_parquet(table).columns])
    collect(store)
    assert table.exists()  # held by a calibration that has not begun
    calibration.until("identify")
    del calibration
    gc.collect()
    collect(store)
    assert table.exists()  # an artifact in use was measured by it
    kincal.Calibration.open(robot, data.head(20), store=store).until("identify")
    gc.collect()
    collected = collect(store)
    assert collected.counts["table"] == 1
    assert not table.exists()
    kincal.Calibration.open(robot, data.head(20), store=store).until("identify")


SCRIPT = """
import kincal
robot = kincal.load("ups3_s", {settings})
print(kincal.sweep(robot, over={{"plan.poses": [12, 16]}}, workers=2, store="store").table["mean_deg"].tolist())
print(kincal.fleet(["ups3_s", "rps3"], until="plan", workers=2, store="store").table["state"].tolist())
"""


def test_workers_do_not_run_the_script_again(tmp_path, environment):
    """A script needs no `if __name__ == "__main__"`."""
    (tmp_path / "study.py").write_text(SCRIPT.format(settings=QUICK))
    call = [sys.executable, tmp_path / "study.py"]
    done = subprocess.run(call, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    errors, states = done.stdout.splitlines()
    assert len(json.loads(errors)) == 12
    assert "ran" in states


def test_a_sweep_and_its_failures(robot, tmp_path):
    events = []
    result = kincal.sweep(
        robot, over={"plan.poses": [12, 2]}, store=tmp_path / "s", output=tmp_path / "o", progress=events.append
    )
    assert [event.done for event in events] == list(range(1, len(events) + 1))
    assert result.table["error"].notna().sum() == 1
    assert result.files[0] == (tmp_path / "o" / "sweep.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(result.files[0]), result.table)
    assert set(result.medians["method"]) == set(result.table["method"].dropna())
    with pytest.raises(kincal.CalibrationError, match="1 of 2 jobs failed"):
        result.check()
    assert "2 jobs, 1 failed" in repr(result)
    texts = kincal.sweep(robot, over=["plan.poses=12,2"], store=tmp_path / "s")
    pd.testing.assert_frame_equal(texts.table, result.table)


@pytest.mark.parametrize(
    "over, message",
    [
        ({"plan.poses": 12}, "over plan.poses: found 12; allowed is a list of values"),
        ({"plan.poses": []}, "over plan.poses: found []; allowed is a list of values"),
        ({"plan.poses": [12, 12]}, "over plan.poses: 12 appears twice"),
        ({"plan.poses": [{1}]}, "over plan.poses: found {1}"),
        ({}, "nothing to sweep"),
        (["plan.poses"], "--over plan.poses: allowed is table.key=value,value,..."),
    ],
)
def test_a_sweep_over_nothing(robot, over, message):
    with pytest.raises(kincal.InputError) as error:
        kincal.sweep(robot, over=over)
    assert message in str(error.value)


def test_threads_are_given_back(monkeypatch):
    from threadpoolctl import threadpool_info

    from kincal.pipeline.run.threads import THREADS, fixed_threads

    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    import torch

    torch.set_num_threads(2)
    before = [(library["filepath"], library["num_threads"]) for library in threadpool_info()]
    with fixed_threads(("numpy", "torch")):
        assert {library["num_threads"] for library in threadpool_info()} == {1}
        assert torch.get_num_threads() == 1
        assert not set(THREADS) & set(os.environ)
    after = [(library["filepath"], library["num_threads"]) for library in threadpool_info()]
    assert after[: len(before)] == before
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)


def test_the_old_names_of_the_cache_commands_name_the_new_ones(cli):
    for name in ("gc", "accept", "verify"):
        answer = cli(name, "ups3_s", "--json", "--store", "anywhere")
        assert (answer.status, answer.out) == (2, "")
        assert answer.err == f"kincal: kincal {name}: write kincal cache {name}\n"
    assert "gc" in cli("cache", "--help").out


BAD_ARGUMENTS = [
    (lambda r: kincal.plan(r, poses="20"), "poses: found '20'; allowed is a whole number"),
    (lambda r: kincal.plan(r, poses=20.5), "poses: found 20.5; allowed is a whole number"),
    (lambda r: kincal.plan(r, poses=True), "poses: found True; allowed is a whole number"),
    (lambda r: kincal.plan(r, layout="circle"), "layout: found 'circle'; allowed are 'grid', 'random', 'd_optimal'"),
    (lambda r: kincal.plan(r, accuracy_deg="fine"), "accuracy_deg: found 'fine'; allowed is a number"),
    (lambda r: kincal.plan(r, output=3), "output: found 3; allowed is a path"),
    (lambda r: kincal.calibrate(r, store=5), "store: found 5; allowed is a path"),
    (lambda r: kincal.identify(r, progress=5), "progress: found 5; allowed are True, False and a function"),
    (lambda r: kincal.sweep(r, {"plan.poses": [12]}, seeds="a"), "seeds: found 'a'; allowed is a whole number"),
    (lambda r: kincal.sweep(r, {"plan.poses": [12]}, workers=0), "--on 0: allowed is a number of worker processes"),
    (lambda r: kincal.sweep(r, {"plan.poses": [12]}, progress="bar"), "progress: found 'bar'; allowed are True"),
    (lambda r: kincal.sweep(r, over="plan.poses=12"), "over: found 'plan.poses=12'; allowed are"),
    (lambda r: kincal.fleet([r]), "robots: found a Robot; allowed are names, paths, and FLEET.toml:UNIT"),
    (lambda r: kincal.fleet(["ups3_s"], until="modl"), "stage 'modl' does not exist; allowed: model"),
    (lambda r: kincal.reproduce(seeds=1.5), "seeds: found 1.5; allowed is a whole number"),
    (lambda r: kincal.sea_trial(r, {"sea_state": 5}), "options: found a dict; allowed is kincal.SeaOptions(...)"),
    (lambda r: kincal.measure(r, seed="a"), "measure.seed: found 'a'"),
    (lambda r: kincal.measure(r, seed=-1), "measure.seed: found -1"),
]


@pytest.mark.parametrize("call, message", BAD_ARGUMENTS)
def test_an_argument_of_the_wrong_kind(robot, call, message, tmp_path, monkeypatch):
    """One line that says what is allowed, and nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", None)
    with pytest.raises(kincal.InputError) as error:
        call(robot)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    del error
    gc.collect()
    assert [file.name for file in tmp_path.rglob("*")] == ["temporary"]


def test_numbers_of_numpy_are_numbers(robot):
    assert len(kincal.plan(robot, poses=np.int64(12), layout="grid", accuracy_deg=None)) == 12


def test_errors_carry_what_a_caller_can_act_on(calibration, data):
    with pytest.raises(kincal.UnknownNameError) as unknown:
        calibration.predict(data, method="hybird")
    assert unknown.value.name == "hybird"
    assert "hybrid" in unknown.value.allowed
    desired = data[["pose", "roll", "pitch", "yaw"]].iloc[:3].copy()
    desired.loc[1, "roll"] = 1.4
    with pytest.raises(kincal.UnreachablePoseError) as unreachable:
        calibration.compensate(desired, strict=True)
    assert unreachable.value.pose == 1
