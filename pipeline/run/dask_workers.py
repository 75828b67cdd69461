"""Workers of a Dask cluster. They share the store through its path, and must run the same code as this process.

Dask sends functions and small values as pickles: that is its wire protocol between machines that trust each other.
Nothing that it sends is kept; artifacts are read and written by the store alone.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from distributed import Client, Worker, get_worker
from distributed.scheduler import KilledWorker
from threadpoolctl import threadpool_limits

from kincal.pipeline.run.fan_out import own_code
from kincal.pipeline.run.stage import all_stages, version
from kincal.pipeline.run.workers import (
    STILL_WANTED,
    JobExecutor,
    WorkerDied,
    WorkersLost,
    bound_threads,
    keep_freed_memory,
    threads_per_worker,
)
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.files import refusing
from kincal.pipeline.store.store import Store
from kincal.urdf.errors import InputError

_PATIENCE = 10.0  # seconds for a scheduler to answer, and for its first worker
_LOST = 60.0  # seconds without any worker
_LOOK = 2.0  # seconds between looks at who is there

_P = ParamSpec("_P")
_T = TypeVar("_T")


class DaskWorkers(JobExecutor):
    """As many jobs at once as the cluster has workers; one that dies costs its own job, which Dask tries again."""

    def __init__(self, address: str, store: Path, files: Sequence[Path]) -> None:
        self._said = f"--on dask://{address}"
        for name in ("distributed", "tornado"):  # what goes wrong is said in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = Client(f"tcp://{address}", timeout=_PATIENCE, set_as_default=False, name="kincal")
        except (OSError, ValueError) as error:
            raise InputError(f"{self._said}: no Dask scheduler answers there ({type(error).__name__})") from None
        try:
            self._facts = self._same_everywhere(store, files)
        except BaseException:
            self._client.close(timeout=1)
            raise
        self._n_workers = len(self._present())
        self._store, self._jobs = store, self._client.get_executor(pure=False)
        self._closed = threading.Event()
        self._waiting: set[Future[Any]] = set()
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def at_once(self) -> int:
        """As last looked: asking the scheduler costs it milliseconds each time."""
        return max(1, self._n_workers)

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        given = self._jobs.submit(_carry_out, digest(self._facts), self._store, threads_per_worker(1), fn, args, kwargs)
        future: Future[_T] = Future()
        self._waiting.add(future)
        given.add_done_callback(lambda given: self._hand_on(given, future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._closed.set()
        self._jobs.shutdown(wait and not cancel_futures)
        self._client.close(timeout=_PATIENCE)

    def kill(self) -> None:
        """A job that runs ends after its stage."""
        self.shutdown(wait=False)

    def _present(self) -> Mapping[str, Any]:
        return self._client.scheduler_info(n_workers=-1)["workers"]

    def _hand_on(self, given: Future[_T], future: Future[_T]) -> None:
        self._waiting.discard(future)
        if future.done():
            return
        if given.cancelled():
            future.set_exception(WorkersLost(f"{self._said}: the scheduler is gone"))
        elif isinstance(error := given.exception(), KilledWorker):
            future.set_exception(WorkerDied(f"each worker that took it died: killed, or out of memory ({self._said})"))
        elif error is not None:
            future.set_exception(error)
        else:
            future.set_result(given.result())

    def _watch(self) -> None:
        """Dask waits for workers for ever."""
        away = 0.0
        while not self._closed.wait(_LOOK):
            self._n_workers = len(self._present())
            away = 0.0 if self._n_workers else away + _LOOK
            if away >= _LOST:
                for future in list(self._waiting):
                    if not future.done():
                        future.set_exception(WorkersLost(f"{self._said}: no worker for {_LOST:.0f} s"))

    def _same_everywhere(self, store: Path, files: Sequence[Path]) -> dict[str, str]:
        """What a result depends on beside its input. Raises InputError where a worker differs, or sees other files."""
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise InputError(f"{self._said}: the scheduler has no workers") from None
        token = store / "tmp" / f"seen-{uuid.uuid4().hex}"
        with refusing(f"store {store}"):
            token.parent.mkdir(parents=True, exist_ok=True)
            token.touch()
        try:
            self._client.run(_begin_importing, threads_per_worker(1), on_error="return")
            facts = _facts(store)
            Store(store).write_memo(own_code(store).used)  # parsing all sources takes a second: once is enough
            answers: Any = self._client.run(_answer, store, token, list(files), on_error="return")
        finally:
            token.unlink(missing_ok=True)
        for worker, answer in answers.items():
            where = f"{self._said}: worker {worker}"
            if isinstance(answer, Exception):
                raise InputError(f"{where}: kincal does not run there: {answer}")
            theirs, unseen = answer
            if unseen is not None:
                raise InputError(f"{where} does not see, or may not write, {unseen}: workers share it by its path")
            changed = [name for name in {**facts, **theirs} if facts.get(name) != theirs.get(name)]
            if changed:
                name = changed[0]
                versions = f" ({theirs.get(name)}, here {facts.get(name)})" if name.startswith("library") else ""
                more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
                raise InputError(f"{where} has another {name}{versions}{more}: the same on all sides, then restart it")
        return facts


# On both sides


@lru_cache(maxsize=1)
def _facts(store: Path) -> dict[str, str]:
    """{what: its digest or version}: of the code as this process has imported it, and of the libraries."""
    facts, libraries = {}, {"distributed"}
    for stage in all_stages().values():
        fingerprint = own_code(store).fingerprint(*stage.place)
        facts |= {f"code, {name}": unit_digest for name, unit_digest in fingerprint.items()}
        libraries |= set(stage.libraries)
    facts |= {f"library, {name}": ".".join(version(name).split(".")[:2]) for name in sorted(libraries)}
    return facts | {"library, python": f"{sys.version_info.major}.{sys.version_info.minor}"}


# In the worker

_IMPORTED = ("pinocchio", "casadi", "pandas", "torch")  # by the stages, and slowly
_ONE = threading.Lock()  # a worker of several threads runs one job at a time: the next one finds it all imported


def _answer(store: Path, token: Path, files: Sequence[Path]) -> tuple[dict[str, str], str | None]:
    """(facts, the first path that is not there or can't be written)."""
    facts = _facts(store)
    unseen = next((str(f) for f in (token, *files) if not f.exists()), None)
    if unseen is not None:
        return facts, str(store) if unseen == str(token) else unseen
    if not os.access(store, os.W_OK):
        return facts, str(store)
    return facts, None


def _begin_importing(n_threads: int) -> None:
    """What the stages import takes seconds: while the caller gets ready, too."""
    threading.Thread(target=_import, args=(n_threads,), daemon=True).start()


def _import(n_threads: int) -> None:
    with _ONE:
        bound_threads(n_threads)
        for library in _IMPORTED:
            import_module(library)


def _carry_out(
    facts: str, store: Path, n_threads: int, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> Any:
    """A job on this worker: one of its own, with a bounded number of threads."""
    worker, key = get_worker(), get_worker().get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state == "executing"

    bound_threads(n_threads)
    keep_freed_memory()
    with _ONE, threadpool_limits(n_threads), _unsampled(worker):
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(n_threads)
        if digest(_facts(store)) != facts:  # one that came later
            raise InputError(f"worker {worker.address} runs other code, or other libraries: restart it")
        token = STILL_WANTED.set(wanted)
        try:
            if not wanted():
                raise CancelledError
            return fn(*args, **kwargs)
        finally:
            STILL_WANTED.reset(token)


@contextmanager
def _unsampled(worker: Worker) -> Iterator[None]:
    """For its dashboard Dask looks at the job's stack a hundred times a second: a tenth of the job's time."""
    sampler = worker.periodic_callbacks.get("profile")
    if sampler is None:
        yield
        return
    worker.loop.add_callback(sampler.stop)
    try:
        yield
    finally:
        worker.loop.add_callback(sampler.start)
