"""Many cases on worker processes that are watched from outside: a crash or a hang in C code costs one case."""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tests.fuzz.case import MEGABYTES, Result, run, shrunk
from tests.fuzz.targets import TARGETS, Target

_SILENT = 90.0  # [s] then a worker is taken for hung
_BATCH = 50  # cases


def shared_out(cases: int, targets: Sequence[Target]) -> list[tuple[Target, range]]:
    """How many cases each target gets; the first of each is its valid file."""
    whole = sum(t.share for t in targets)
    return [(t, range(max(1, round(cases * t.share / whole)))) for t in targets]


def campaign(
    cases: int,
    workers: int,
    targets: Sequence[Target] = TARGETS,
    keep: Path | None = None,
    observe: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """All results; keep: a folder for the files of each kind of defect, cut down."""
    batches = []
    for target, numbers in shared_out(cases, targets):
        batches += [(TARGETS.index(target), numbers[k : k + _BATCH]) for k in range(0, len(numbers), _BATCH)]
    batches.reverse()
    results: list[Result] = []
    running: list[_Worker] = [_Worker(keep) for _ in range(min(workers, len(batches)))]
    try:
        while running:
            for worker in running:
                if worker.idle and batches:
                    worker.give(*batches.pop())
            busy = [w for w in running if not w.idle]
            if not busy:
                break
            ready = wait([w.pipe for w in busy], timeout=1.0)
            for worker in busy:
                result = worker.take(worker.pipe in ready)
                if result is not None:
                    results.append(result)
                    observe(result)
    finally:
        for worker in running:
            worker.stop()
    return results


@dataclass
class _Worker:
    keep: Path | None
    waiting: list[int] = field(default_factory=list)
    target: int = 0
    process: Any = None
    pipe: Connection = field(init=False)
    heard: float = 0.0

    def __post_init__(self) -> None:
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, self.keep), daemon=True)
        self.process.start()
        theirs.close()
        self.heard = time.monotonic() + 60  # for its imports

    @property
    def idle(self) -> bool:
        return not self.waiting

    def give(self, target: int, numbers: Sequence[int]) -> None:
        self.target, self.waiting = target, list(numbers)
        self.pipe.send((target, self.waiting))
        self.heard = max(self.heard, time.monotonic())

    def take(self, ready: bool) -> Result | None:
        if ready:
            try:
                result = self.pipe.recv()
                self.waiting.pop(0)
                self.heard = time.monotonic() + (30 if result.outcome == "defect" else 0)  # it may be cut down
                return result
            except EOFError:
                self.process.join()
                return self._lost(f"the process died ({self.process.exitcode})")
        if time.monotonic() - self.heard > _SILENT:
            return self._lost(f"no answer in {_SILENT:g} s")
        return None

    def _lost(self, why: str) -> Result:
        number, *rest = self.waiting
        self.stop()
        self._start()
        self.waiting = []
        if rest:
            self.give(self.target, rest)
        return Result(TARGETS[self.target].name, number, "defect", why, _SILENT, 0.0)

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _work(pipe: Connection, keep: Path | None) -> None:
    """A worker: what it prints goes to a file, its memory is bounded."""
    kept: dict[str, int] = defaultdict(int)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        printed = os.open(root / "printed", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        sys.stdin.close()
        _warm(root)
        _bound_memory()
        while True:
            try:
                target, numbers = pipe.recv()
            except EOFError:
                return
            for number in numbers:
                chosen = TARGETS[target]
                result = run(chosen, number, root)
                pipe.send(result)
                if result.outcome == "defect" and keep is not None and kept[result.said[:40]] < 1:
                    kept[result.said[:40]] += 1
                    _keep(keep, chosen, result, root)


def _warm(root: Path) -> None:
    """Libraries are loaded before the first case: their time and memory are nobody's fault."""
    for target in TARGETS:
        run(target, 0, root)


def _bound_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        most = pages * resource.getpagesize() + int(2 * MEGABYTES * 2**20)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _keep(keep: Path, target: Target, result: Result, root: Path) -> None:
    name = "".join(c if c.isalnum() else "_" for c in target.name)
    folder = keep / f"{name}-{result.number}"
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in shrunk(target, result, root).items():
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_bytes(content)
    (folder / "defect.txt").write_text(f"{target.name}, case {result.number}: {result.said}\n")
