"""Dask clusters of processes that come late, die and lose each other; and clusters that talk TLS."""

import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import dask.config
import pytest

from kincal.pipeline.run import dask_workers
from kincal.pipeline.run.executor import Place, executor, place
from kincal.urdf.errors import CalibrationError, InputError

OTHER = """
from kincal.pipeline.run import dask_jobs
dask_jobs.facts = lambda store, own=dask_jobs.facts: own(store) | {"library, numpy": "1.26"}
"""


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self, folder: Path, environment: dict[str, str], protocol: str = "tcp") -> None:
        self._folder, self._environment = folder, environment | {"DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "info"}
        self._processes: list[subprocess.Popen] = []
        secure = ["--protocol", protocol] if protocol != "tcp" else []
        self.scheduler = self._started("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *secure)
        match = self._awaited(r"Scheduler at: +(\w+://127\.0\.0\.1:\d+)", "scheduler0")
        self._url = match[1]
        self.address = self._url.partition("//")[2]

    def worker(self, *options: str) -> subprocess.Popen:
        process = self._started("worker", self._url, "--nthreads", "1", "--no-dashboard", *options)
        self._awaited("Starting established connection", f"worker{len(self._processes) - 1}")
        return process

    def _started(self, kind: str, *options: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options]
        with open(self._folder / f"{kind}{len(self._processes)}", "w") as log:
            process = subprocess.Popen(
                command, cwd=self._folder, env=self._environment, stdout=log, stderr=log, start_new_session=True
            )
        self._processes.append(process)
        return process

    def _awaited(self, pattern: str, name: str) -> re.Match:
        end = time.monotonic() + 30
        while time.monotonic() < end:
            match = re.search(pattern, (self._folder / name).read_text())
            if match:
                return match
            time.sleep(0.05)
        raise AssertionError((self._folder / name).read_text())

    def close(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture
def cluster(tmp_path, environment):
    """cluster(protocol, **environment) -> Cluster."""
    started, levels = [], {name: logging.getLogger(name).level for name in ("distributed", "tornado", "asyncio")}

    def start(protocol: str = "tcp", **more: str) -> Cluster:
        started.append(Cluster(tmp_path, environment() | more, protocol))
        return started[-1]

    yield start
    for one in started:
        one.close()
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    monkeypatch.setattr(dask_workers, "_LOOK", 0.1)


def until(condition) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


WAITS = """
import os, pathlib, time
folder = pathlib.Path({folder!r})
(folder / "began").touch()
while not (folder / "go").exists():
    time.sleep(0.02)
(folder / "ran").write_text(str(os.getpid()))
"""


def test_a_worker_of_another_version_that_comes_late(cluster, tmp_path, caplog, monkeypatch):
    """It gets no jobs: neither new ones, nor that of a worker that was killed, nor the last ones."""
    (tmp_path / "other.py").write_text(OTHER)
    running = cluster()
    first = running.worker("--no-nanny")

    def waiting():
        with executor(Place(0, running.address), tmp_path) as workers:
            job = workers.submit(exec, WAITS.format(folder=str(tmp_path)))
            until((tmp_path / "began").exists)
            running.worker("--no-nanny", "--preload", str(tmp_path / "other.py"))
            until(lambda: "has another library, numpy (1.26, here 2." in caplog.text)
            assert workers.at_once == 1
            os.killpg(first.pid, signal.SIGKILL)
            until(lambda: not workers._fit)
            good = running.worker("--no-nanny")
            (tmp_path / "go").touch()
            assert job.result(timeout=20) is None
            assert (tmp_path / "ran").read_text() == str(good.pid)
            assert {workers.submit(eval, "__import__('os').getpid()").result() for _ in range(3)} == {good.pid}
            assert len([r for r in caplog.records if "It gets no jobs" in r.getMessage()]) == 1
            monkeypatch.setattr(dask_workers, "_LOST", 0.5)
            os.killpg(good.pid, signal.SIGKILL)
            workers.submit(time.sleep, 20).result(timeout=30)

    with pytest.raises(CalibrationError, match=r"no worker of this version for .* to continue"):
        waiting()


def test_the_scheduler_is_lost(cluster, tmp_path):
    """The real command: one line, no traceback, and what was computed stays."""
    running = cluster()
    running.worker("--no-nanny")
    store = tmp_path / "store"
    command = [sys.executable, "-m", "kincal", "sweep", "ups3_s", "--over", "plan.poses=20,30", "--store", str(store)]
    with subprocess.Popen(
        [*command, "--on", f"dask://{running.address}"], cwd=tmp_path, env=running._environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        until(lambda: list(store.glob("artifacts/model/*/manifest.json")))
        running.scheduler.kill()
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert not out
    (line,) = [line for line in err.splitlines() if not line.startswith("ups3_s ")]
    assert line.startswith(f"kincal: --on dask://{running.address}: the scheduler is gone")
    assert line.endswith("run the same command again to continue")
    assert list(store.glob("artifacts/model/*/manifest.json"))


# TLS


def test_places():
    assert place("tls://host:8786") == Place(0, "host:8786", "tls")
    assert place("dask://host:8786") == Place(0, "host:8786")
    with pytest.raises(InputError, match=r"--on tls://host: allowed is .* tls://host:port"):
        place("tls://host")


@pytest.fixture
def certificate(tmp_path) -> dict[str, str]:
    """Dask's settings, of which the environment is one place, with a certificate that was made for the test."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate with")
    made = ["-nodes", "-keyout", "key.pem", "-out", "cert.pem", "-days", "2", "-subj", "/CN=localhost"]
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", *made]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    cert, key = str(tmp_path / "cert.pem"), str(tmp_path / "key.pem")
    sides = {f"{side}.{name}": file for side in ("client", "scheduler", "worker") for name, file in
             (("cert", cert), ("key", key))}  # fmt: skip
    return {f"distributed.comm.tls.{name}": file for name, file in {"ca-file": cert, **sides}.items()}


def in_environment(settings: dict[str, str]) -> dict[str, str]:
    return {"DASK_" + name.upper().replace(".", "__").replace("-", "_"): file for name, file in settings.items()}


def test_tls_with_dasks_own_settings(cluster, tmp_path, certificate, cli):
    running = cluster("tls", **in_environment(certificate))
    running.worker("--no-nanny")
    address = f"tls://{running.address}"
    answer = cli("run", "ups3_s", "--until", "model", "--on", address)
    assert answer.status == 2
    assert "Dask has no certificates; set distributed.comm.tls.ca-file" in answer.err
    assert answer.err.count("\n") == 1
    with dask.config.set(certificate):
        answer = cli("run", "ups3_s", "--until", "model", "--on", address)
    assert answer.status == 0, answer.err
    assert answer.out.split()[-2:] == ["ups3_s", "ran"]


def test_certificates_that_are_not_there(cli, certificate):
    with dask.config.set(dict.fromkeys(certificate, "/nowhere/cert.pem")):
        answer = cli("run", "ups3_s", "--until", "model", "--on", "tls://127.0.0.1:1")
    assert answer.status == 2
    assert answer.err.count("\n") == 1
    assert "distributed.comm.tls.client.key: can't be read: " in answer.err


def test_a_scheduler_that_talks_no_tls(cluster, cli, certificate, monkeypatch):
    monkeypatch.setattr(dask_workers, "_PATIENCE", 1.0)
    running = cluster()
    with dask.config.set(certificate):
        answer = cli("run", "ups3_s", "--until", "model", "--on", f"tls://{running.address}")
    assert answer.status == 2
    assert answer.err.count("\n") == 1
    assert "no Dask scheduler answers there" in answer.err
    assert "or it does not accept the certificates" in answer.err
