"""Where jobs run: the same results everywhere, shared beginnings once, and a worker that dies costs its job alone."""

import os
import platform
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.small import QUICK
from kincal.pipeline.run.executor import Place, executor, place
from kincal.pipeline.run.fan_out import Failure, Job, Outcome, run_all, run_of
from kincal.pipeline.run.workers import WorkerDied, threads_per_worker, undisturbed
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError

QUIET = ('measure.channels=["orientation"]', "identify.max_iterations=200")


def jobs(store: Path, until: str, *overrides: tuple[str, ...]) -> list[Job]:
    return [Job("ups3_s", (*QUIET, *own), store, until) for own in overrides]


def done(jobs: list[Job], on: int, observe=lambda task, outcome: None) -> list:
    robots = [load_robot(job.robot, job.overrides).description for job in jobs]
    with executor(Place(on), jobs[0].store) as workers:
        return run_all(jobs, robots, workers, observe)


def grid(store: Path) -> list[Job]:
    return jobs(store, "measure", *((f"plan.poses={n}", f"seed={s}") for s in (0, 1) for n in (12, 14)))


# Anywhere the same


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """{workers: (outcomes, tasks that ran)} of one grid, each in a store of its own."""
    found = {}
    for on in (1, 2):
        tasks = []
        outcomes = done(
            grid(tmp_path_factory.mktemp("grid")), on, lambda task, o, tasks=tasks: o and tasks.append((task, o))
        )
        found[on] = outcomes, tasks
    return found


def test_the_same_digests_in_process_and_on_two_workers(both):
    digests = [[[(p.stage, p.digest) for p in o.passed] for o in outcomes] for outcomes, _ in both.values()]
    assert digests[0] == digests[1]
    assert len({row[-1] for row in digests[0]}) == 4


@pytest.mark.parametrize("on", [1, 2])
def test_what_jobs_share_runs_once(both, on):
    """Nothing runs twice; what is shared runs ahead of the jobs, which find it in the cache."""
    outcomes, tasks = both[on]
    ran = Counter((p.stage, p.key) for _, o in tasks for p in o.passed if p.state == "ran")
    assert set(ran.values()) == {1}
    assert Counter(stage for stage, _ in ran)["model"] == 1
    ahead = [task for task, _ in tasks if not task.final]
    assert [(task.job.until, len(task.jobs)) for task in ahead] == [("model", 4)]
    for outcome in outcomes:
        assert next(p.state for p in outcome.passed if p.stage == "model") == "cached"


def test_a_worker_that_dies_costs_its_stage_alone(tmp_path, dies_once):
    with executor(Place(2), tmp_path) as workers:
        workers.submit(exec, dies_once(tmp_path)).result()
    assert (tmp_path / "passed").read_text() == "cached cached ran"


@pytest.mark.parametrize("on", [1, 2])
def test_a_job_whose_files_the_system_refuses_fails_alone(tmp_path, on):
    good, bad = jobs(tmp_path, "model", ("plan.poses=12",), ("plan.poses=13",))
    bad = replace(bad, store=tmp_path / ("a" * 300))
    robots = [load_robot(job.robot, job.overrides).description for job in (good, bad)]
    with executor(Place(on), tmp_path) as workers:
        found, failed = run_all([good, replace(bad, until="plan")], robots, workers)
    assert isinstance(found, Outcome)
    assert "File name too long" in str(failed.error)


def test_a_second_time_all_is_cached(tmp_path):
    (job,) = jobs(tmp_path, "plan", ("plan.poses=12",))
    first, second = done([job], 1)[0], done([job], 1)[0]
    assert {p.state for p in first.passed} == {"ran"}
    assert {p.state for p in second.passed} == {"cached"}
    assert [p.digest for p in first.passed] == [p.digest for p in second.passed]
    run = run_of(job)
    assert run.store.last(run.robot_id, "plan") is None  # what the robot itself used last stays


def test_ways_that_part_do_not_wait_for_each_other(tmp_path):
    """What is begun together rests on nothing that another task is still making."""
    from kincal.pipeline.run.task_graph import prefix_of, shared_tasks

    settings = [(f"identify.max_iterations={n}", f"seed={s}") for s in (0, 1, 2) for n in (200, 300)]
    listed = jobs(tmp_path, "evaluate", *settings)
    robots = [load_robot(job.robot, job.overrides).description for job in listed]
    tasks, waits_for = shared_tasks(listed, [prefix_of("evaluate", robot) for robot in robots])
    prefixes = [prefix_of(t.job.until, robots[t.jobs[0]]) for t in tasks]
    before = [set(w) for w in waits_for]
    for k in range(len(tasks)):
        before[k].update(*(before[other] for other in waits_for[k]))
    for a in range(len(tasks)):
        made = set(prefixes[a].values()) - {key for k in before[a] for key in prefixes[k].values()}
        assert made, "a task of its own makes something"
        for b in range(a):
            if b not in before[a]:
                assert not made & set(prefixes[b].values())


def test_an_idle_worker_goes_ahead(tmp_path):
    """While `siblings` is made for all, the other worker makes what a job has for itself alone; nothing runs twice."""
    tasks, begun = [], []

    def observe(task, outcome):
        (tasks if outcome else begun).append((task, outcome))

    quick = [part for part in QUICK if not part.startswith(("siblings.iterations", "measure.channels"))]
    settings = [(*quick, "siblings.iterations=6000", f"measure.seed={s}") for s in (0, 1)]
    outcomes = done(jobs(tmp_path, "correct", *settings), 2, observe)
    (made,) = {task.jobs for task, _ in tasks if task.job.until == "siblings"}
    assert made == (0, 1)
    early = [task for task, _ in tasks if not task.final and len(task.jobs) == 1]
    assert [task.job.until for task in early] == ["identify"] * len(early)
    assert early[0].jobs == (0,)
    order = [(task.final, task.job.until) for task, _ in tasks]
    assert order.index((False, "identify")) < order.index((False, "siblings"))
    ran = Counter((p.stage, p.key) for _, o in tasks for p in o.passed if p.state == "ran")
    assert set(ran.values()) == {1}
    assert [[p.stage for p in o.passed] for o in outcomes] == [[p.stage for p in outcomes[0].passed]] * 2
    assert len(begun) == len(tasks)


FAULTS = """
import resource
import numpy as np
np.ones(500_000).sum()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(200):
    np.ones(500_000).sum()
open({file!r}, "w").write(str(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no mallopt")
def test_workers_keep_the_memory_that_they_free(tmp_path, monkeypatch):
    """200 arrays of 4 MB, one after the other, with what Dask sets for its workers: each is 977 pages."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    files = [tmp_path / "worker", tmp_path / "alone"]
    in_worker, by_itself = (FAULTS.format(file=str(file)) for file in files)
    with executor(Place(2), Path()) as workers:
        workers.submit(exec, in_worker).result()
    subprocess.run([sys.executable, "-c", by_itself], check=True)
    kept, alone = (int(file.read_text()) for file in files)
    assert alone > 100_000
    assert kept < 10_000


# What fails


def test_a_job_that_fails_leaves_the_others(tmp_path):
    settings = [
        ("plan.poses=12",),
        ("plan.poses=12", "identify.max_iterations=1"),
        ("plan.poses=12", "measure.table=gone.csv"),
    ]
    first, *others = jobs(tmp_path, "identify", *settings)
    fine, failed, bad = done([replace(first, until="measure"), *others], 1)
    assert not isinstance(fine, Failure)
    assert "did not converge" in str(failed.error)
    assert isinstance(bad.error, InputError)
    assert "gone.csv" in str(bad.error)


def test_what_waits_for_a_failed_beginning_fails_by_its_error(tmp_path):
    settings = [(f"plan.poses={n}", "workspace.max_condition=1.01") for n in (12, 14)]
    tasks = []
    outcomes = done(jobs(tmp_path, "plan", *settings), 1, lambda task, o: tasks.append((task.final, o)))
    assert all(isinstance(o, Failure) for o in outcomes)
    assert len({str(o.error) for o in outcomes}) == 1
    assert [final for final, o in tasks if o is None] == [False]  # the jobs were never handed out


def test_a_worker_that_dies_costs_its_job_alone():
    with executor(Place(2), Path()) as workers:
        dies, lives = workers.submit(os._exit, 1), workers.submit(eval, "__import__('time').sleep(0.3) or 7")
        assert lives.result() == 7
        with pytest.raises(WorkerDied, match="twice"):
            dies.result()
        assert workers.submit(eval, "6 * 7").result() == 42


def test_a_job_whose_worker_died_is_tried_once_more(tmp_path):
    once = f"import os, pathlib; p = pathlib.Path({str(tmp_path / 'been')!r}); p.exists() or (p.touch(), os._exit(1))"
    with executor(Place(2), Path()) as workers:
        assert workers.submit(exec, once).result() is None


# Ends


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_an_exception_kills_the_workers():
    pids = []

    def interrupted():
        with executor(Place(2), Path()) as workers:
            pids.append(workers.submit(os.getpid).result())
            running = [workers.submit(time.sleep, 60) for _ in range(5)]
            while not running[0].running():
                time.sleep(0.01)
            raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - began < 20
    assert not alive(pids[0])


CHILD = """
import os, sys, time
from pathlib import Path
from kincal.pipeline.run.executor import Place, executor
if __name__ == "__main__":
    with executor(Place(2), Path()) as workers:
        print(workers.submit(os.getpid).result(), flush=True)
        workers.submit(time.sleep, 60).result()
"""


def test_workers_do_not_outlive_a_parent_that_was_killed(tmp_path, environment):
    (tmp_path / "child.py").write_text(CHILD)
    command = [sys.executable, tmp_path / "child.py"]
    with subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        assert alive(pid)
        parent.kill()
    end = time.monotonic() + 10
    while alive(pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert not alive(pid)


def test_what_is_being_written_is_finished_first():
    finished = []

    def write():
        with undisturbed():
            signal.raise_signal(signal.SIGINT)
            finished.append(True)

    with pytest.raises(KeyboardInterrupt):
        write()
    assert finished == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Settings


def test_threads_of_workers_do_not_fight_over_the_cores(monkeypatch):
    with executor(Place(2), Path()) as workers:
        names = "[__import__('os').environ[n + '_NUM_THREADS'] for n in ('OMP', 'OPENBLAS', 'MKL')]"
        assert workers.submit(eval, names).result() == ["1", "1", "1"]
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    for given, n, expected in (("1", 2, 1), ("16", 2, 4), ("2", 2, 2), ("16", 20, 1), ("4,2", 2, 1)):
        monkeypatch.setenv("OMP_NUM_THREADS", given)
        assert threads_per_worker(n) == expected


@pytest.mark.parametrize(
    "on",
    ["0", "-1", "two", "1.5", "", "99999", "9" * 5000, "٣", "dask://", "dask://here", "dask://here:0", "dask://a b:1"],
)
def test_what_on_refuses(on):
    with pytest.raises(InputError, match=r"--on .*allowed is a number"):
        place(on)


def test_what_on_takes():
    assert place("3") == Place(3)
    assert place("dask://node-1.cluster:8786") == Place(0, "node-1.cluster:8786")
    assert place("dask://[::1]:8786").scheduler == "[::1]:8786"
