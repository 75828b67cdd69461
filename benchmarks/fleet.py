"""A fleet of 3-UPS/S units: speed on 1 and 2 workers and on Dask, memory, cost a robot, and 200 that are cached.

Each row is a whole `kincal run --all` in a process of its own, on an empty store but for the last ones. The peer is
what one would write in a shell: one `kincal run` a unit, two at a time, on one store. What is compared takes
turns, since the speed of a machine changes within minutes. Some twenty minutes on two quiet cores.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.store import Store
from kincal.urdf.fleet import load, references

SETTINGS = """
[set]
plan.poses = 60
measure.channels = ["orientation"]
evaluate.closed_loop = false
"""
TURNS = 4
TARGET_SPEED, TARGET_DASK, TARGET_MEMORY, TARGET_CACHED = 1.7, 1.15, 1.5e9, 5.0
_ENVIRONMENT = dict(os.environ)  # without what a cluster in this process adds for its workers


@dataclass(frozen=True)
class Timed:
    seconds: float
    memory: int  # the largest resident set of one process [bytes]


def fleet(folder: Path, n: int) -> Path:
    """A fleet file of n units, each with a seed of its own."""
    file = folder / f"fleet{n}.toml"
    units = "".join(f'[[unit]]\nname = "hull_{k:03d}"\nseed = {k}\n' for k in range(n))
    file.write_text(f'design = "ups3_s"\n{SETTINGS}{units}')
    return file


def timed(commands: Sequence[Sequence[str | Path]], at_once: int, watched: Sequence[psutil.Process] = ()) -> Timed:
    """Whole processes, `at_once` of them side by side; and the memory of theirs, and of those watched."""
    waiting, running, largest, done = list(commands), [], 0, threading.Event()

    def watch() -> None:
        nonlocal largest
        while not done.wait(0.2):
            for parent in (*watched, *(psutil.Process(p.pid) for p in list(running) if p.poll() is None)):
                try:
                    for process in (parent, *parent.children(recursive=True)):
                        largest = max(largest, process.memory_info().rss)
                except psutil.NoSuchProcess:
                    continue

    watcher = threading.Thread(target=watch, daemon=True)
    began = time.perf_counter()
    watcher.start()
    while waiting or running:
        while waiting and len(running) < at_once:
            command = waiting.pop(0)
            running.append(
                subprocess.Popen(command, env=_ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            )
        ended = next((p for p in running if p.poll() is not None), None)
        if ended is None:
            time.sleep(0.01)
            continue
        running.remove(ended)
        if ended.returncode:
            raise SystemExit(ended.stderr.read().decode() if ended.stderr else "")
    seconds = time.perf_counter() - began
    done.set()
    watcher.join()
    return Timed(seconds, largest)


def fill(references: Sequence[str], like: str, store: Store) -> None:
    """What these robots lack in the store is there afterwards: the results of the one that is all cached, `like`."""
    template = Run(load(like), store)
    assert all(state == "fresh" for _, state, _ in template.status())
    for reference in references:
        run = Run(load(reference), store)
        for stage in all_stages().values():
            parts = run.key_parts(stage)
            found = store.find(stage.name, digest(parts))
            if found is None:
                like_it = template.entries[stage.name]
                sealed = {"parts": parts, "provenance": like_it.manifest["provenance"]}
                found = store.save(stage.name, digest(parts), store.load(like_it, stage.result), sealed)
            run.entries[stage.name] = found


def kincal(*arguments: str | Path, until: str = "evaluate") -> list[str | Path]:
    return [sys.executable, "-m", "kincal", "run", *arguments, "--until", until]


def row(what: str, found: Timed, note: str = "") -> None:
    print(f"{what:<58} {found.seconds:7.1f} s  {found.memory / 1e9:5.2f} GB  {note}", flush=True)


def main() -> None:
    from distributed import LocalCluster

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)

        def run(n: int, on: str, name: str, **options) -> Timed:
            store = ("--store", folder / name, "--output", folder / name)
            return timed([kincal("--all", "--from", fleet(folder, n), "--on", on, *store)], 1, **options)

        print(f"{'whole process':<58} {'':9}  largest process")
        options, turns = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}, []
        for k in range(TURNS):
            one = run(24, "1", f"one{k}")
            row("24 units, 1 worker", one)
            two = run(24, "2", f"two{k}")
            row("24 units, 2 workers", two, f"{one.seconds / two.seconds:.2f} x")
            with LocalCluster(**options) as cluster:
                workers = [psutil.Process(nanny.pid) for nanny in cluster.workers.values()]
                dask = run(24, cluster.scheduler_address.replace("tcp", "dask"), f"dask{k}", watched=workers)
            row("24 units, Dask, 2 workers", dask, f"{dask.seconds / two.seconds:.2f} x the time")
            six, many = run(6, "2", f"six{k}"), run(48, "2", f"many{k}")
            row("6 units, 2 workers", six)
            row("48 units, 2 workers", many)
            turns.append((one, two, dask, six, many))
        alone, pool, on_dask, few, most = np.mean([[found.seconds for found in turn] for turn in turns], axis=0)
        print(f"in the mean: 2 workers {alone / pool:.2f} x the speed of 1 (target {TARGET_SPEED}); ", end="")
        print(f"Dask {on_dask / pool:.2f} x the time of the pool (target {TARGET_DASK})")
        tables = {(folder / name / "fleet.parquet").read_bytes() for name in ("one0", "two0", "dask0")}
        print(f"the three tables are {'the same bytes' if len(tables) == 1 else 'DIFFERENT'}")

        first, more = (pool - few) / 18, (most - pool) / 24
        print(f"each robot more, from 6 to 24: {first:.2f} s, from 24 to 48: {more:.2f} s ({more / first:.2f} x)")
        largest = max(found.memory for turn in turns for found in turn)
        print(f"largest process {largest / 1e9:.2f} GB (target {TARGET_MEMORY / 1e9} GB)")

        peer = timed([kincal(f"{fleet(folder, 6)}:hull_{k:03d}", "--store", folder / "peer") for k in range(6)], 2)
        row("6 units, one kincal each, two at a time", peer, f"{peer.seconds / few:.2f} x the time of 2 workers")
        file, like, store = fleet(folder, 200), f"{fleet(folder, 24)}:hull_000", folder / "two0"
        timed([kincal(like, "--store", store, until="report")], 1)
        fill(references(file), like, Store(store))
        cached = kincal("--all", "--from", file, "--store", store, until="report")
        timed([cached], 1)  # publishes the reports
        found = timed([cached], 1)
        row("200 units, all cached, with their reports", found, f"(target {TARGET_CACHED:.0f} s)")


if __name__ == "__main__":
    main()
