"""`kincal sweep`: the grid, the table, the figure, and what it says of jobs that fail."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.studies.grid import combinations, parse_over, toml_value
from kincal.urdf.errors import InputError

# --over

WORDS = st.sampled_from(
    ["grid", "random", '"a, b"', "'c,d'", "true", "1e-3", "-2.5", '["tilt", "yaw"]', '{ x = "a,b" }']
)


@given(st.lists(WORDS, min_size=1, max_size=6, unique=True), st.sampled_from(["", " "]))
def test_values_are_split_outside_of_brackets_and_quotes(words, space):
    over = parse_over(f"table.key={space}{f',{space}'.join(words)}")
    assert over.key == "table.key"
    assert over.texts == tuple(words)
    assert over.values == tuple(toml_value(word) for word in words)


@given(
    st.integers(-500, 500),
    st.integers(-40, 40).filter(bool),
    st.integers(2, 60),
    st.sampled_from([0, 1, 3]),
)
def test_a_progression_is_what_it_stands_for(first, step, n, decimals):
    """first,second,...,last in integers and in exact decimals is the list of all."""

    def text(k: int) -> str:
        value = first + k * step
        sign, digits = "-" * (value < 0), f"{abs(value):0{decimals + 1}d}"
        return f"{sign}{digits[:-decimals]}.{digits[-decimals:]}" if decimals else str(value)

    written = parse_over(f"a.b={text(0)},{text(1)},...,{text(n)}")
    listed = parse_over("a.b=" + ",".join(text(k) for k in range(n + 1)))
    assert written.values == listed.values
    assert written.numeric


def test_progressions_follow_each_other():
    assert parse_over("plan.poses=10,20,...,40,60,...,100").values == (10, 20, 30, 40, 60, 80, 100)


def test_all_combinations():
    overs = [parse_over("a=1,2"), parse_over("b=x,y,z")]
    assert combinations(overs) == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]


@pytest.mark.parametrize(
    "text, said",
    [
        ("plan.poses", "allowed is table.key=value"),
        ("=1,2", "allowed is table.key=value"),
        ("a=", "a value is missing"),
        ("a=1,,2", "a value is missing"),
        ("a=1,2,1", "1 appears twice"),
        ("a=1,2,...", "between two values and the last one"),
        ("a=1,...,5", "between two values and the last one"),
        ("a=...", "between two values and the last one"),
        ("a=1,2,...,...", "counts in numbers"),
        ("a=x,y,...,z", "counts in numbers"),
        ("a=1,nan,...,5", "counts in numbers"),
        ("a=1,1e999999,...,5", "counts in numbers"),
        ("a=10,20,...,45", "no steps of 10 lead from 20 to 45"),
        ("a=10,20,...,0", "no steps of 10"),
        ("a=1,1,...,5", "no steps of 0"),
        ("a=1,2,...,1000000000", "allowed are 10000"),
        ('a=["x"', "not closed"),
        ("a=x],y", "not closed"),
        ("a='x,y", "not closed"),
        ("a=1," + "9" * 5000, "digits"),
        ("a=1," + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ],
)
def test_what_over_refuses(text, said):
    with pytest.raises(InputError, match="--over ") as refused:
        parse_over(text)
    assert said in str(refused.value)


def test_what_no_table_holds_stays_a_text():
    written = ("nan", "-inf", "2020-01-01", "1" + "0" * 30, "[inf]")
    assert parse_over("a=" + ",".join(written)).values == written


@given(st.text(alphabet="0123456789.,=[]{}\"'e-xé \n", max_size=40))
def test_any_text_is_values_or_one_error(text):
    try:
        over = parse_over(f"a.b={text}")
    except InputError:
        return
    assert over.texts
    assert len(over.values) == len(set(over.texts))


# The command


def arguments_of(finished, store) -> list[str]:
    return ["sweep", "ups3_s", *(part for s in finished.settings for part in ("--set", s)), "--store", str(store)]


@pytest.fixture
def sweep(cli, store, finished):
    """sweep(*arguments) -> Answer: of the robot of the finished run, whose stages are in the store."""
    return lambda *arguments: cli(*arguments_of(finished, store), *arguments)


def document(answer) -> dict:
    return json.loads(answer.out, parse_constant=lambda constant: pytest.fail(f"{constant} is no JSON"))


OVER = ("--over", "transfer.iterations=10,12", "--output", "results")


@pytest.fixture
def first(sweep, tmp_path):
    """A sweep of one cached job and one that runs; then (answer, folder of results)."""
    return sweep(*OVER), tmp_path / "results"


def test_a_sweep(first, sweep, finished):
    answer, folder = first
    assert answer.status == 0, answer.err
    assert "1/2 transfer.iterations=10  cached" in answer.err
    for word in (*METHODS, "median over 1 seed of the mean error [deg]", "results/sweep.parquet", "results/sweep.svg"):
        assert word in answer.out

    table = pd.read_parquet(folder / "sweep.parquet")
    assert list(table["transfer.iterations"]) == [10] * len(METHODS) + [12] * len(METHODS)
    assert list(table["method"]) == list(METHODS) * 2
    assert set(table["robot"]) == {"ups3_s"}
    assert set(table["scored_on"]) == {"fresh"}
    assert set(table["n_poses"]) == {12}
    assert table["error"].isna().all()
    scores = {m.name: m for m in finished.comparison.methods}
    closed = {m.name: m for m in finished.comparison.closed_loop}
    held_out = {m.name: m for m in finished.comparison.held_out}
    for row in table[: len(METHODS)].to_dict(orient="records"):
        score = scores[row["method"]]
        assert (row["mean_deg"], row["max_deg"], row["sd_deg"]) == (score.mean_deg, score.max_deg, score.sd_deg)
        assert {axis: row[f"{axis}_deg"] for axis in "xyz"} == score.axis_mean_deg
        assert row["held_out_mean_deg"] == held_out[row["method"]].mean_deg
        if row["method"] in closed:
            assert row["closed_loop_mean_deg"] == closed[row["method"]].mean_deg
    assert table["mean_mm"].isna().all()

    # Again: all cached, the same bytes; and the document says what the table says.
    bytes_of = {f.name: f.read_bytes() for f in folder.iterdir()}
    assert set(bytes_of) == {"sweep.parquet", "sweep.svg"}
    again = sweep(*OVER, "--json")
    assert again.status == 0
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == bytes_of
    said = document(again)
    assert (said["robot"], said["jobs"], said["failed"]) == ("ups3_s", 2, 0)
    assert said["over"] == {"transfer.iterations": [10, 12]}
    assert [row["mean_deg"] for row in said["rows"]] == list(table["mean_deg"])
    assert [row["mean_deg"] for row in said["medians"]] == list(table["mean_deg"])
    assert len(said["medians"]) == 2 * len(METHODS)
    assert b"<dc:date>" not in bytes_of["sweep.svg"]
    assert all(name.encode() in bytes_of["sweep.svg"] for name in METHODS)


def test_a_job_that_fails_is_a_row(sweep, store):
    """By default beside what the robot used last; the exit status tells."""
    answer = sweep("--over", "identify.max_iterations=1,1000", "--json")
    assert answer.status == 1
    assert "1 of 2 jobs failed, the first (identify.max_iterations=1)" in answer.err.splitlines()[-1]
    assert "Traceback" not in answer.err
    said = document(answer)
    assert said["failed"] == 1
    assert "did not converge" in said["rows"][0]["error"]
    assert said["rows"][0]["method"] is None
    assert [row["method"] for row in said["rows"][1:]] == list(METHODS)
    (file,) = (store / "robots").glob("*/sweep.parquet")
    assert str(file) == said["table"]
    assert len(pd.read_parquet(file)) == 1 + len(METHODS)


def test_a_value_that_no_robot_can_have_is_a_row(sweep):
    answer = sweep("--over", "plan.poses=-3,12", "--json")
    assert answer.status == 1
    assert document(answer)["rows"][0]["error"].startswith("--over plan.poses=-3: plan.poses: ")
    assert [row["plan.poses"] for row in document(answer)["rows"]] == [-3] + [12] * len(METHODS)


def test_words_and_lists_are_swept_as_they_were_written(sweep):
    answer = sweep("--over", 'measure.channels=["orientation"],["wind"]', "--output", "results", "--json")
    said = document(answer)
    assert answer.status == 1
    assert said["over"] == {"measure.channels": [["orientation"], ["wind"]]}
    assert [row["measure.channels"] for row in said["rows"]] == ['["orientation"]'] * len(METHODS) + ['["wind"]']
    assert said["figure"] is None


@pytest.mark.parametrize(
    "arguments, said",
    [
        ((), "nothing to sweep"),
        (("--seeds", "0"), "--seeds 0"),
        (("--seeds", "2", "--over", "seed=1,2"), "--over seed: swept twice"),
        (("--over", "plan.poses=1,2", "--over", "plan.poses=3"), "--over plan.poses: swept twice"),
        (("--over", "plan.poses=-1,-2"), "--over plan.poses=-1: plan.poses"),
        (("--over", "plan.posse=10,20"), "did you mean 'poses'?"),
        (("--over", "plan.poses=1,2,...,9000", "--seeds", "5"), "45000 jobs"),
        (("--over", "plan.poses=10,20", "--on", "dask://here"), "--on dask://here"),
        (("--over", "identify.max_iterations=1,2"), "2 of 2 jobs failed"),
        (("--over", "plan.poses=12,13", "--output", "file"), "--output file: can't be written"),
    ],
)
def test_bad_input_is_one_line(sweep, tmp_path, arguments, said):
    (tmp_path / "file").write_text("mine")
    answer = sweep(*arguments)
    assert answer.status == (1 if "max_iterations" in str(arguments) else 2)
    assert said in answer.err.splitlines()[-1]
    assert "Traceback" not in answer.err
    assert (tmp_path / "file").read_text() == "mine"


# Accidents


def workers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task").glob("*/children")
    found = [int(child) for file in children for child in file.read_text().split()]
    return [child for child in found if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


@pytest.fixture
def begun(finished, store, tmp_path, environment):
    """A sweep on two workers in a process of its own, as soon as a worker is seen; killed at the end."""
    command = [sys.executable, "-m", "kincal", *arguments_of(finished, store), "--on", "2", "--json"]
    command += ["--over", "identify.max_iterations=1,2,1000"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, env=environment(), stdout=pipe, stderr=pipe, text=True) as process:
        while process.poll() is None and not workers_of(process.pid):
            time.sleep(0.02)
        yield process
        process.kill()


def test_a_killed_worker_costs_nothing_but_time(begun):
    os.kill(workers_of(begun.pid)[0], signal.SIGKILL)
    out, err = begun.communicate(timeout=60)
    assert begun.returncode == 1, err
    assert [row["method"] for row in json.loads(out)["rows"]] == [None, None, *METHODS]
    assert "died" not in err


def test_an_interrupt_ends_all(begun, store):
    time.sleep(1)
    pids = workers_of(begun.pid)
    begun.send_signal(signal.SIGINT)
    out, err = begun.communicate(timeout=30)
    assert (begun.returncode, out) == (130, "")
    assert err.splitlines()[-1] == "kincal: interrupted"
    assert "Traceback" not in err
    assert pids
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not list((store / "tmp").iterdir())
