"""Where jobs run: in this process, in worker processes, or on a Dask cluster."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kincal.pipeline.run.workers import InProcess, JobExecutor, Workers, WorkersLost
from kincal.pipeline.store.ownership import warn_of_others
from kincal.urdf.errors import CalibrationError, InputError

MOST_WORKERS = 1024
_ADDRESS = re.compile(
    r"(?P<protocol>dask|tls)://(?P<host>[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})", re.ASCII
)


@dataclass(frozen=True)
class Place:
    """What `--on` asks for."""

    workers: int  # processes; 1: this process
    scheduler: str | None = None  # host:port of a Dask cluster, which has its own
    protocol: str = "tcp"  # or tls, with Dask's own certificates


def place(on: str) -> Place:
    """Raises InputError."""
    if on.isascii() and on.isdigit() and len(on) < 9 and 1 <= int(on) <= MOST_WORKERS:
        return Place(int(on))
    match = _ADDRESS.fullmatch(on)
    if match and 0 < int(match["port"]) < 65536:
        return Place(0, f"{match['host']}:{match['port']}", "tls" if match["protocol"] == "tls" else "tcp")
    raise InputError(
        f"--on {on}: allowed is a number of worker processes, 1 to {MOST_WORKERS}, dask://host:port, or tls://host:port"
    )


@contextmanager
def executor(on: Place, store: Path, files: Iterable[Path] = ()) -> Iterator[JobExecutor]:
    """The workers that `--on` asks for. Left by an exception, it cancels and kills. Raises InputError.

    store, files: what a cluster's workers must see at the same paths.
    """
    warn_of_others(store)
    if on.scheduler is not None:
        from kincal.pipeline.run.dask_workers import DaskWorkers

        workers: JobExecutor = DaskWorkers(on.scheduler, store, sorted(set(files)), on.protocol)
    else:
        workers = InProcess() if on.workers == 1 else Workers(on.workers)
    try:
        yield workers
    except WorkersLost as error:
        workers.kill()
        raise CalibrationError(
            f"{error}; finished results are in the store: run the same command again to continue"
        ) from None
    except BaseException:
        workers.kill()
        raise
    workers.shutdown()
