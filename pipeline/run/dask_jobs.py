"""What a worker of a Dask cluster does for kincal: it says what it runs, and carries out jobs one at a time."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker
from threadpoolctl import threadpool_limits

from kincal.pipeline.run.fan_out import own_code
from kincal.pipeline.run.stage import all_stages, version
from kincal.pipeline.run.workers import STILL_WANTED, bound_threads, keep_freed_memory
from kincal.pipeline.store.digests import digest


class OtherCode(Exception):
    """A job came to a worker of another version. args: the worker's address."""


@lru_cache(maxsize=1)
def facts(store: Path) -> dict[str, str]:
    """{what: its digest or version}: of the code as this process has imported it, and of the libraries."""
    known, libraries = {}, {"distributed"}
    for stage in all_stages().values():
        fingerprint = own_code(store).fingerprint(*stage.place)
        known |= {f"code, {name}": unit_digest for name, unit_digest in fingerprint.items()}
        libraries |= set(stage.libraries)
    known |= {f"library, {name}": ".".join(version(name).split(".")[:2]) for name in sorted(libraries)}
    return known | {"library, python": f"{sys.version_info.major}.{sys.version_info.minor}"}


def problem_of(answer: Any, here: dict[str, str]) -> str | None:
    """Why a worker that answered can't have jobs; None: it can. here: the facts of who asks."""
    if isinstance(answer, Exception):
        return f"can't run kincal: {answer}"
    theirs, unseen = answer
    if unseen is not None:
        return f"does not see, or may not write, {unseen}: workers share it by its path"
    changed = [name for name in {**here, **theirs} if here.get(name) != theirs.get(name)]
    if not changed:
        return None
    name = changed[0]
    versions = f" ({theirs.get(name)}, here {here.get(name)})" if name.startswith("library") else ""
    more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
    return f"has another {name}{versions}{more}: the same on all sides, then restart it"


# In the worker

_IMPORTED = ("pinocchio", "casadi", "pandas", "torch")  # by the stages, and slowly
_ONE = threading.Lock()  # a worker of several threads runs one job at a time: the next one finds it all imported


def answer(store: Path, token: Path, files: Sequence[Path]) -> tuple[dict[str, str], str | None]:
    """(facts, the first path that is not there or can't be written)."""
    known = facts(store)
    unseen = next((str(f) for f in (token, *files) if not f.exists()), None)
    if unseen is not None:
        return known, str(store) if unseen == str(token) else unseen
    if not os.access(store, os.W_OK):
        return known, str(store)
    return known, None


def begin_importing(n_threads: int) -> None:
    """What the stages import takes seconds: while the caller gets ready, too."""
    threading.Thread(target=_import, args=(n_threads,), daemon=True).start()


def _import(n_threads: int) -> None:
    with _ONE:
        bound_threads(n_threads)
        for library in _IMPORTED:
            import_module(library)


def carry_out(
    digest_of_facts: str,
    store: Path,
    n_threads: int,
    fn: Callable[..., Any],
    args: tuple[Any, ...],
    kwargs: dict[str, Any],
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
        if digest(facts(store)) != digest_of_facts:  # restarted meanwhile, under the same address
            raise OtherCode(worker.address)
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
