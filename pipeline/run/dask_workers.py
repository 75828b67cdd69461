"""Workers of a Dask cluster. They share the store through its path, and must run the same code as this process.

Dask sends functions and small values as pickles: that is its wire protocol between machines that trust each other.
Nothing that it sends is kept; artifacts are read and written by the store alone.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import dask.config
from distributed import Client
from distributed.scheduler import KilledWorker
from distributed.security import Security

from kincal.pipeline.run.dask_jobs import OtherCode, problem_of
from kincal.pipeline.run.dask_jobs import answer as _answer
from kincal.pipeline.run.dask_jobs import begin_importing as _begin_importing
from kincal.pipeline.run.dask_jobs import carry_out as _carry_out
from kincal.pipeline.run.dask_jobs import facts as _facts
from kincal.pipeline.run.fan_out import own_code
from kincal.pipeline.run.workers import JobExecutor, WorkerDied, WorkersLost, threads_per_worker
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.files import refusing
from kincal.pipeline.store.store import Store
from kincal.urdf.errors import InputError

_PATIENCE = 10.0  # seconds for a scheduler to answer, and for its first worker
_LOST = 60.0  # seconds without any worker
_LOOK = 2.0  # seconds between looks at who is there
_TRIES = 3  # of a job whose workers are all gone
_TLS = "distributed.comm.tls.ca-file, distributed.comm.tls.client.cert and distributed.comm.tls.client.key"

_P = ParamSpec("_P")
_T = TypeVar("_T")
_logger = logging.getLogger("kincal.pipeline")


@dataclass(eq=False)
class _Job:
    """A job that somebody waits for, and where it is now."""

    future: Future[Any]
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
    sent: Future[Any] | None = None  # None: it waits for a worker that may have it
    workers: frozenset[str] = frozenset()  # any of them may have it
    tries: int = 0


class DaskWorkers(JobExecutor):
    """As many jobs at once as the cluster has workers of this version; others, which came later, get none.

    A worker that dies costs its own job alone, which is tried again.
    """

    def __init__(self, address: str, store: Path, files: Sequence[Path], protocol: str = "tcp") -> None:
        self._label = f"--on {'tls' if protocol == 'tls' else 'dask'}://{address}"
        _silence("distributed", "tornado", "asyncio")
        self._store, self._files = store, files
        self._client = self._connected(f"{protocol}://{address}")
        try:
            self._facts, self._fit = self._same_everywhere()
        except OSError as error:
            self._client.close(timeout=1)
            raise InputError(f"{self._label}: the scheduler is gone ({type(error).__name__})") from None
        except BaseException:
            self._client.close(timeout=1)
            raise
        self._turned_away: set[str] = set()
        self._executor = self._client.get_executor(pure=False)
        self._closed, self._wake, self._lock = threading.Event(), threading.Event(), threading.RLock()
        self._waiting: set[_Job] = set()
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def at_once(self) -> int:
        """As last looked: asking the scheduler costs it milliseconds each time."""
        return max(1, len(self._fit))

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        job = _Job(Future(), (fn, args, kwargs))
        with self._lock:
            self._waiting.add(job)
            self._send(job)
        return job.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._closed.set()
        self._wake.set()
        self._executor.shutdown(wait and not cancel_futures)
        self._client.close(timeout=_PATIENCE)

    def kill(self) -> None:
        """A job that runs ends after its stage."""
        self.shutdown(wait=False)

    def _connected(self, address: str) -> Client:
        """With Dask's own settings of security. Raises InputError."""
        secure = address.startswith("tls:")
        if secure and not dask.config.get("distributed.client.security-loader"):
            self._check_certificates()
        try:
            return Client(address, timeout=_PATIENCE, set_as_default=False, name="kincal")
        except (OSError, ValueError) as error:
            more = f", or it does not accept the certificates of {_TLS}" if secure else ""
            kind = type(error).__name__
            raise InputError(f"{self._label}: no Dask scheduler answers there ({kind}){more}") from None

    def _check_certificates(self) -> None:
        """A client that learns of it as it connects takes 20 s to close."""
        try:
            context = Security().get_connection_args("client").get("ssl_context")
        except (OSError, ValueError) as error:  # a file that is not there, or holds no certificate
            raise InputError(f"{self._label}: {_TLS}: can't be read: {error}") from None
        if context is None:
            raise InputError(f"{self._label}: Dask has no certificates; set {_TLS} in its configuration")

    def _present(self) -> Collection[str]:
        return self._client.scheduler_info(n_workers=-1)["workers"]

    # Jobs

    def _send(self, job: _Job) -> None:
        """To the workers of this version alone; where there are none it waits."""
        job.sent, job.workers = None, frozenset(self._fit)
        if not job.workers:
            return
        job.tries += 1
        known = digest(self._facts), self._store, threads_per_worker(1)
        where: Any = {"workers": sorted(job.workers), "allow_other_workers": False}
        try:
            sent = self._executor.submit(_carry_out, *known, *job.call, **where)
        except (OSError, RuntimeError):  # the connection is closed
            self._settle(job, WorkersLost(f"{self._label}: the scheduler is gone"))
            return
        job.sent = sent
        sent.add_done_callback(lambda sent: self._hand_on(sent, job))

    def _hand_on(self, sent: Future[Any], job: _Job) -> None:
        with self._lock:
            if job.sent is not sent:  # sent elsewhere meanwhile
                return
            if sent.cancelled():
                self._settle(job, WorkersLost(f"{self._label}: the scheduler is gone"))
            elif isinstance(error := sent.exception(), OtherCode):
                self._send_elsewhere(job, error.args[0])
            elif isinstance(error, KilledWorker):
                self._settle(job, self._died())
            elif error is not None:
                self._settle(job, error)
            else:
                self._waiting.discard(job)
                job.future.set_result(sent.result())

    def _send_elsewhere(self, job: _Job, worker: str) -> None:
        """Where the worker was started anew, under the same address, with other code."""
        problem = "runs other code, or other libraries: restart it"
        self._turn_away(worker, problem)
        if self._fit:
            job.sent, job.tries = None, job.tries - 1
            self._wake.set()
        else:
            self._settle(job, InputError(f"{self._label}: worker {worker} {problem}"))

    def _settle(self, job: _Job, error: BaseException) -> None:
        self._waiting.discard(job)
        if not job.future.done():
            job.future.set_exception(error)

    def _died(self) -> WorkerDied:
        return WorkerDied(f"each worker that took it died: killed, or out of memory ({self._label})")

    # Workers

    def _watch(self) -> None:
        """Dask waits for workers for ever, and gives jobs to whoever comes."""
        last = time.monotonic()
        while not self._closed.is_set():
            self._wake.wait(_LOOK)
            self._wake.clear()
            if self._closed.is_set():
                return
            try:
                self._look()
            except Exception as error:  # of a connection that breaks Dask raises whatever it stumbles over
                if not self._closed.is_set():
                    self._give_up(f"the scheduler is gone ({type(error).__name__})")
                return
            last = time.monotonic() if self._fit else last
            if time.monotonic() - last >= _LOST:
                self._give_up(f"no worker {'of this version ' if self._turned_away else ''}for {_LOST:.0f} s")

    def _look(self) -> None:
        """Who came, who went, and whose jobs must go elsewhere."""
        present = set(self._present())
        with self._lock:
            self._turned_away &= present
            self._fit &= present
            others = present - self._fit - self._turned_away
        if others:
            self._examine(others)
        left: list[Future[Any]] = []
        with self._lock:
            for job in list(self._waiting):
                if job.sent is not None:
                    if job.workers & present:
                        continue
                    left.append(job.sent)
                    job.sent = None
                if job.tries >= _TRIES:
                    self._settle(job, self._died())
                else:
                    self._send(job)
        for sent in left:  # without the lock: it waits for Dask's thread, which may wait for the lock
            sent.cancel()

    def _examine(self, workers: Iterable[str]) -> None:
        problems: dict[str, str | None] = {}
        for worker in workers:
            try:
                problems |= self._problems(self._facts, [worker])
            except Exception as error:  # an answer that Dask can't read, as of another Python
                problems[worker] = f"can't run kincal: {type(error).__name__}"
        with self._lock:
            for worker, problem in problems.items():
                if problem is None:
                    self._fit.add(worker)
                else:
                    self._turn_away(worker, problem)

    def _turn_away(self, worker: str, problem: str) -> None:
        if worker not in self._turned_away:
            _logger.warning("%s: worker %s %s. It gets no jobs", self._label, worker, problem)
        self._turned_away.add(worker)
        self._fit.discard(worker)

    def _give_up(self, why: str) -> None:
        with self._lock:
            for job in list(self._waiting):
                self._settle(job, WorkersLost(f"{self._label}: {why}"))

    def _same_everywhere(self) -> tuple[dict[str, str], set[str]]:
        """What a result depends on beside its input, and the workers. Raises InputError where one differs."""
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise InputError(f"{self._label}: the scheduler has no workers") from None
        self._client.run(_begin_importing, threads_per_worker(1), on_error="return")
        facts = _facts(self._store)
        Store(self._store).write_memo(own_code(self._store).used)  # to parse all sources takes a second
        problems = self._problems(facts)
        for worker, problem in problems.items():
            if problem is not None:
                raise InputError(f"{self._label}: worker {worker} {problem}")
        return facts, set(problems)

    def _problems(self, facts: dict[str, str], workers: list[str] | None = None) -> dict[str, str | None]:
        """{worker: why it can't have jobs}; None: it can. Raises InputError where the store can't be written."""
        token = self._store / "tmp" / f"seen-{uuid.uuid4().hex}"
        with refusing(f"store {self._store}"):
            token.parent.mkdir(parents=True, exist_ok=True)
            token.touch()
        try:
            answers: Any = self._client.run(
                _answer, self._store, token, list(self._files), workers=workers, on_error="return"
            )
        finally:
            token.unlink(missing_ok=True)
        gone = {worker for worker, answer in answers.items() if isinstance(answer, OSError)}
        return {worker: problem_of(answers[worker], facts) for worker in answers if worker not in gone}


def _silence(*libraries: str) -> None:
    """What goes wrong is said in one line. Dask gives its loggers levels of their own."""
    for name in (*libraries, *logging.root.manager.loggerDict):
        if name.partition(".")[0] in libraries:
            logging.getLogger(name).setLevel(logging.CRITICAL)
