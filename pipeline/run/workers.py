"""Workers on this machine: this process, or processes of its own. Each is a `concurrent.futures.Executor`."""

from __future__ import annotations

import atexit
import ctypes
import os
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from queue import LifoQueue
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from kincal.urdf.errors import CalibrationError

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_GRACE = 1.0  # seconds for a worker to finish what it is writing
_KEPT = ((-3, 32 << 20), (-1, 512 << 20))  # bytes; glibc's M_MMAP_THRESHOLD and M_TRIM_THRESHOLD

# Whether the job that this worker is at is still waited for: a job looks between its stages.
STILL_WANTED: ContextVar[Callable[[], bool]] = ContextVar("still_wanted", default=lambda: True)

_P = ParamSpec("_P")
_T = TypeVar("_T")


class WorkerDied(CalibrationError):
    """A job whose worker died, twice."""


class WorkersLost(RuntimeError):
    """Nobody is left to run jobs."""


class JobExecutor(Executor, ABC):
    """An executor that says how many jobs it runs at once."""

    @property
    @abstractmethod
    def at_once(self) -> int: ...

    def kill(self) -> None:
        """Cancel what has not begun, and end the rest as soon as nothing is left half written."""


class InProcess(JobExecutor):
    """Runs a job as it is submitted."""

    @property
    def at_once(self) -> int:
        return 1

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        future: Future[_T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _WorkerProcess(SpawnProcess):
    """Does not run the caller's main script: a script that starts a study without a guard would start itself again."""

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return SpawnProcess._Popen(process_obj)  # pyright: ignore[reportAttributeAccessIssue]
        finally:
            sys.modules["__main__"] = main


class _WorkerContext(SpawnContext):
    Process = _WorkerProcess


class Workers(JobExecutor):
    """Worker processes, each a pool of its own with a thread here that waits for it.

    In one common pool a worker that dies takes its neighbours along, and nobody knows whose job it was. Here it costs
    only its own job, which is tried once more in a new process: jobs must bear being begun twice.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._threads = ThreadPoolExecutor(n, "worker", initializer=_block_interrupts)
        self._n_threads = threads_per_worker(n)
        self._idle: LifoQueue[ProcessPoolExecutor] = LifoQueue()  # the last used first: it has imported most
        self._lock = threading.Lock()
        self._pools: set[ProcessPoolExecutor] = set()
        self._closing = False
        for _ in range(n):
            self._idle.put(self._started())

    @property
    def at_once(self) -> int:
        return self._n

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        return self._threads.submit(self._run, fn, args, kwargs)

    def _run(self, fn: Callable[..., _T], args: tuple[Any, ...], kwargs: dict[str, Any]) -> _T:
        pool = self._idle.get()
        try:
            for _ in range(2):
                with self._lock:  # kill() sees every process that starts here, or none starts any more
                    if self._closing:
                        raise CancelledError
                    future = pool.submit(fn, *args, **kwargs)
                try:
                    return future.result()
                except BrokenProcessPool:
                    pool = self._replaced(pool)
            raise WorkerDied("its worker process died, twice: killed, or out of memory (--on with fewer workers)")
        finally:
            self._idle.put(pool)

    def _started(self) -> ProcessPoolExecutor:
        """A pool of one process, which starts with its first job."""
        pool = ProcessPoolExecutor(1, _WorkerContext(), initializer=_begin, initargs=(self._n_threads,))
        self._pools.add(pool)
        return pool

    def _replaced(self, broken: ProcessPoolExecutor) -> ProcessPoolExecutor:
        broken.shutdown(wait=False)
        with self._lock:
            self._pools.discard(broken)
            return self._started()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)

    def kill(self) -> None:
        """One that is writing an artifact may finish that."""
        with self._lock:
            self._closing = True
            # A pool forgets its processes as it shuts down.
            processes = [process for pool in self._pools for process in dict(pool._processes or {}).values()]
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(_GRACE)
            process.kill()
        self.shutdown()


def threads_per_worker(n: int) -> int:
    """So that n workers don't fight over the cores; never more than this process was given, which is 1 by default."""
    given = os.environ.get("OMP_NUM_THREADS", "1")
    return max(1, min(int(given) if given.isdigit() else 1, (os.cpu_count() or 1) // n))


def _block_interrupts() -> None:
    """Ctrl-C reaches all processes of a terminal. Workers inherit this: only the parent decides what ends."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


# In the worker process


def _begin(n_threads: int) -> None:
    """Before numpy or torch are imported, which read their number of threads once."""
    bound_threads(n_threads)
    keep_freed_memory()
    atexit.register(os._exit, 0)  # torch would take half a second to tidy up what ends anyway
    threading.Thread(target=_outlive_nobody, daemon=True).start()


def bound_threads(n: int) -> None:
    """Of libraries that are loaded later."""
    for name in _THREADS:
        os.environ[name] = str(n)


def keep_freed_memory() -> None:
    """What one array leaves is there for the next, where the C library is glibc.

    Else threads, and all of a Dask worker (it comes with MALLOC_TRIM_THRESHOLD_=65536), give it back to the kernel and
    fetch it again page by page: docs/how-to/fleet.md says how long that takes.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        for option, size in _KEPT:
            mallopt(option, size)


def _outlive_nobody() -> None:
    """A parent that was killed can't end its workers."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Requests to end wait until this is done: an artifact that is half written would be left behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    late: list[int] = []
    asked = (signal.SIGINT, signal.SIGTERM)
    usual = {number: signal.signal(number, lambda number, _: late.append(number)) for number in asked}
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler or signal.SIG_DFL)
        for number in late:
            signal.raise_signal(number)
