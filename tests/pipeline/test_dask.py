"""A Dask cluster: the same results, one line for what is wrong with it, and nothing left behind."""

import logging
import os
import time
from pathlib import Path

import pytest

from kincal.pipeline.run import dask_workers
from kincal.pipeline.run.executor import Place, executor
from kincal.pipeline.run.fan_out import Failure, Job, _outcome, run_all
from kincal.pipeline.run.workers import WorkerDied
from kincal.urdf.description import load_robot
from kincal.urdf.errors import CalibrationError, InputError


@pytest.fixture(scope="module")
def scheduler():
    """host:port of a cluster of one worker, a process with a nanny that starts it anew."""
    from distributed import LocalCluster

    levels = {name: logging.getLogger(name).level for name in ("distributed", "tornado")}
    options = {"n_workers": 1, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with pytest.MonkeyPatch.context() as greedy:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            greedy.setenv(name, "2")
        cluster = LocalCluster(**options, silence_logs=logging.CRITICAL)
    with cluster:
        yield cluster.scheduler_address.removeprefix("tcp://")
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


def test_threads_are_bounded_where_numpy_was_there_first(scheduler, tmp_path):
    """First of all: a worker that was started anew has this process's own, bounded environment."""
    threads = "[x['num_threads'] for x in __import__('threadpoolctl').threadpool_info()]"
    with executor(Place(0, scheduler), tmp_path) as workers:
        assert 2 in workers._client.submit(eval, f"__import__('numpy') and {threads}").result()
        assert set(workers.submit(eval, threads).result()) == {1}
        assert workers.submit(eval, "__import__('os').environ['OMP_NUM_THREADS']").result() == "1"


SAMPLED = """
import time
from distributed import get_worker
sampler = get_worker().periodic_callbacks["profile"]
end = time.monotonic() + 20
while sampler.is_running() is not {wanted} and time.monotonic() < end:
    time.sleep(0.01)
assert sampler.is_running() is {wanted}
"""


def test_a_job_is_not_sampled_others_are(scheduler, tmp_path):
    """Dask's statistical profiler takes a tenth of a worker's time (docs/how-to/fleet.md)."""
    with executor(Place(0, scheduler), tmp_path) as workers:
        for _ in range(2):
            workers.submit(exec, SAMPLED.format(wanted=False)).result()
            workers._client.submit(exec, SAMPLED.format(wanted=True), pure=False).result()


def digests(on: Place, store: Path) -> list[list[str]]:
    quiet = ('measure.channels=["orientation"]',)
    jobs = [Job("ups3_s", (*quiet, f"plan.poses={n}"), store, "measure") for n in (12, 14)]
    with executor(on, store) as workers:
        outcomes = run_all(jobs, [load_robot(job.robot, job.overrides).description for job in jobs], workers)
    return [[p.digest for p in outcome.passed] for outcome in outcomes]


def test_the_same_digests_in_process_and_on_dask(scheduler, tmp_path):
    found = digests(Place(0, scheduler), tmp_path / "dask")
    assert found == digests(Place(1), tmp_path / "here")
    assert len({row[-1] for row in found}) == 2
    assert not list((tmp_path / "dask" / "tmp").iterdir())


def test_a_worker_that_dies_costs_its_stage_alone(scheduler, tmp_path, dies_once):
    with executor(Place(0, scheduler), tmp_path) as workers:
        workers.submit(exec, dies_once(tmp_path)).result()
    assert (tmp_path / "passed").read_text() == "cached cached ran"


def test_a_job_that_kills_each_worker(scheduler, tmp_path, monkeypatch):
    """As where the system ends what takes too much memory. A nanny starts the worker anew, with another address."""
    monkeypatch.setattr(dask_workers, "_LOOK", 0.1)
    with executor(Place(0, scheduler), tmp_path) as workers:
        with pytest.raises(WorkerDied, match="each worker that took it died: killed, or out of memory"):
            workers.submit(os._exit, 1).result(timeout=60)
        assert workers.submit(eval, "6 * 7").result(timeout=20) == 42


def test_a_job_that_needs_too_much_memory(scheduler, tmp_path):
    """Where the worker itself notices."""
    raises = "raise MemoryError"
    for on in (Place(0, scheduler), Place(1)):
        with executor(on, tmp_path) as workers:
            failure = _outcome(workers.submit(exec, raises))
        assert isinstance(failure, Failure)
        assert isinstance(failure.error, CalibrationError)
        assert "out of memory; finished results stay in the store" in str(failure.error)


WAITS = """
import pathlib, time
from kincal.pipeline.run.workers import STILL_WANTED
folder = pathlib.Path({folder!r})
(folder / "began").touch()
end = time.monotonic() + 20
while STILL_WANTED.get()() and time.monotonic() < end:
    time.sleep(0.02)
(folder / "ended").write_text(str(STILL_WANTED.get()()))
"""


def until(there: Path) -> None:
    end = time.monotonic() + 20
    while not there.exists() and time.monotonic() < end:
        time.sleep(0.02)
    assert there.exists()


def test_interrupted_jobs_end_after_their_stage(scheduler, tmp_path):
    def interrupted():
        with executor(Place(0, scheduler), tmp_path) as workers:
            workers.submit(exec, WAITS.format(folder=str(tmp_path)))
            until(tmp_path / "began")
            workers.submit((tmp_path / "never").touch)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    until(tmp_path / "ended")
    assert (tmp_path / "ended").read_text() == "False"
    with executor(Place(0, scheduler), tmp_path) as workers:
        assert workers.submit(eval, "6 * 7").result() == 42
    assert not (tmp_path / "never").exists()


def test_the_command(scheduler, cli):
    answer = cli("run", "ups3_s", "rps3", "--until", "model", "--on", f"dask://{scheduler}")
    assert answer.status == 0, answer.err
    assert [line.split() for line in answer.out.splitlines()] == [
        ["robot", "model"],
        ["ups3_s", "ran"],
        ["rps3", "ran"],
    ]
    assert "2/2 rps3" in answer.err
    assert cli("status", "ups3_s").out.splitlines()[1].split() == ["model", "fresh"]


# What is refused


def refused(cli, scheduler: str, said: str) -> None:
    answer = cli("run", "ups3_s", "--until", "model", "--on", f"dask://{scheduler}")
    assert answer.status == 2, answer
    assert answer.err.count("\n") == 1, answer.err
    assert said in answer.err
    assert not answer.out


def test_no_scheduler(cli, monkeypatch):
    monkeypatch.setattr(dask_workers, "_PATIENCE", 0.3)
    refused(cli, "127.0.0.1:1", "no Dask scheduler answers there")


def test_no_workers(cli, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(dask_workers, "_PATIENCE", 0.3)
    with LocalCluster(n_workers=0, processes=False, dashboard_address=":0", protocol="tcp") as cluster:
        refused(cli, cluster.scheduler_address.removeprefix("tcp://"), "the scheduler has no workers")


def test_other_code_on_the_workers(cli, scheduler, monkeypatch):
    ours = dask_workers._facts

    def changed(store):
        return ours(store) | {"code, kincal.pipeline.methods.networks": "other"}

    monkeypatch.setattr(dask_workers, "_facts", changed)
    refused(cli, scheduler, "has another code, kincal.pipeline.methods.networks: ")
    monkeypatch.setattr(dask_workers, "_facts", lambda store: ours(store) | {"library, numpy": "1.0"})
    refused(cli, scheduler, "has another library, numpy (2.")


def test_other_code_on_a_worker_that_came_later(scheduler, tmp_path):
    with executor(Place(0, scheduler), tmp_path) as workers:
        workers._facts = {}
        with pytest.raises(InputError, match="runs other code"):
            workers.submit(eval, "6 * 7").result()


def test_workers_that_do_not_see_the_files(scheduler, tmp_path, monkeypatch):
    """As where the store is a folder of this machine alone: what the parent has written is not there."""
    with (
        pytest.raises(InputError, match=r"does not see.* /nowhere/robot.toml"),
        executor(Place(0, scheduler), tmp_path, [Path("/nowhere/robot.toml")]),
    ):
        pass
    monkeypatch.setattr(Path, "touch", lambda self: None)
    with pytest.raises(InputError, match=f"does not see.* {tmp_path}: "), executor(Place(0, scheduler), tmp_path):
        pass


def test_what_is_lost_is_said(scheduler, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_workers, "_LOST", 0.2)
    monkeypatch.setattr(dask_workers, "_LOOK", 0.1)

    def waiting():
        with executor(Place(0, scheduler), tmp_path) as workers:
            monkeypatch.setattr(workers, "_present", dict)
            workers.submit(time.sleep, 1).result()

    with pytest.raises(CalibrationError, match="no worker for"):
        waiting()
