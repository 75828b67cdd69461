"""Many jobs over few workers: what several jobs share runs once, first, and nobody waits for a neighbour meanwhile.

A worker that has nothing to do while something shared is being made goes ahead with a job's own stages.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from kincal.pipeline.results import Comparison
from kincal.pipeline.run.fingerprint import Code
from kincal.pipeline.run.provenance import provenance
from kincal.pipeline.run.runner import Event, Run
from kincal.pipeline.run.task_graph import Ahead, Job, Task, prefix_of, shared_tasks
from kincal.pipeline.run.workers import STILL_WANTED, JobExecutor, undisturbed
from kincal.pipeline.store.manifest import Entry
from kincal.pipeline.store.store import Store
from kincal.urdf.description import RobotDescription, as_absolute
from kincal.urdf.errors import OUT_OF_MEMORY, CalibrationError, InputError, of_system
from kincal.urdf.fleet import is_unit, load


@dataclass(frozen=True)
class Passed:
    """A stage that a job went through."""

    stage: str
    state: str  # ran, cached
    seconds: float | None
    key: str
    digest: str  # of its result's content


@dataclass(frozen=True)
class Outcome:
    """What a worker says of its job: small values; the data is in the store."""

    passed: tuple[Passed, ...]
    damaged: tuple[str, ...]  # artifacts that were set aside
    comparison: Comparison | None  # where the job's last stage makes one
    provenance: Mapping[str, Any]  # of what the job was for


@dataclass(frozen=True)
class Failure:
    """A job that came to nothing."""

    error: InputError | CalibrationError


# observe(task, None) as a task is handed to a worker, and again with what came of it
Observe = Callable[[Task, Outcome | Failure | None], None]


class _JobStore(Store):
    """A store whose artifacts are finished before this process ends.

    noted: what a job used is noted down as what its robot used last; else only that a study is using it.
    """

    def __init__(self, root: Path, noted: bool) -> None:
        super().__init__(root)
        self._noted = noted

    def remember(self, robot: str, stage: str, key: str) -> None:
        if self._noted:
            super().remember(robot, stage, key)

    def save(self, stage: str, key: str, value: Any, manifest: Mapping[str, Any], replace: bool = False) -> Entry:
        with undisturbed():
            if not self._noted:
                self.begin(manifest["provenance"]["robot"], stage, key)
            return super().save(stage, key, value, manifest, replace)


@lru_cache(maxsize=1)
def _imported() -> Code:
    return Code()


def own_code(store: Path) -> Code:
    """Of the sources as this process has imported them: each is read once, whatever is edited while jobs run."""
    code = _imported()
    if not code.used:
        code.memo.update(Store(store).read_memo())
    return code


def portable(overrides: Iterable[str]) -> tuple[str, ...]:
    """The same settings for a worker that runs in another folder."""
    return tuple(as_absolute(text) for text in overrides)


def files_of(jobs: Sequence[Job], robots: Sequence[RobotDescription]) -> set[Path]:
    """What workers read beside the store."""
    files = {Path(job.robot.rpartition(":")[0] if is_unit(job.robot) else job.robot) for job in jobs}
    for robot in robots:
        measure = robot.measure
        others = (measure.table, measure.joints, measure.streams, measure.commands)
        files |= {robot.urdf, *(file for file in others if file is not None)}
    return files


def run_of(job: Job, observe: Callable[[Event], None] = lambda event: None) -> Run:
    """A job's way, to be gone in this process. Raises InputError."""
    robot = load(job.robot, job.overrides)
    return Run(robot, _JobStore(job.store, job.noted), None, observe, job.command, _code=own_code(job.store))


def carry_out(job: Job) -> Outcome:
    """Go a job's way. Raises InputError and CalibrationError; CancelledError where nobody waits for it any more."""
    events: list[Event] = []

    def observe(event: Event) -> None:
        if not STILL_WANTED.get()():
            raise CancelledError
        events.append(event)

    run = run_of(job, observe)
    last = "evaluate" if job.until == "report" else job.until
    if job.until == "report":
        value, report = run.until(last, "report")
        if job.noted:
            run.publish(report)
    else:
        (value,) = run.until(last)
    passed = []
    for event in (e for e in events if e.state in ("ran", "cached")):
        entry = run.entries[event.stage]
        passed.append(Passed(event.stage, event.state, event.seconds, entry.manifest["key"], entry.digest))
    damaged = tuple(e.why for e in events if e.state == "damaged")
    comparison = value if isinstance(value, Comparison) else None
    return Outcome(tuple(passed), damaged, comparison, provenance(run.entries, [last], job.command))


def run_all(
    jobs: Sequence[Job],
    robots: Sequence[RobotDescription],
    workers: JobExecutor,
    observe: Observe = lambda task, outcome: None,
) -> list[Outcome | Failure]:
    """The outcomes of jobs in their order. robots: as the jobs' overrides make them.

    Where a shared beginning fails, all of its jobs do, by the same error.
    """
    prefixes = [prefix_of(job.until, robot) for job, robot in zip(jobs, robots, strict=True)]
    tasks, waits_for = shared_tasks(jobs, prefixes)
    ahead, n_known = Ahead(jobs, prefixes), len(tasks)
    outcomes: dict[int, Outcome | Failure] = {}
    unblocks = defaultdict(list)
    for k, others in enumerate(waits_for):
        for other in others:
            unblocks[other].append(k)
    # What most jobs wait for comes first.
    ready = [(-len(tasks[k].jobs), k) for k, others in enumerate(waits_for) if not others]
    heapq.heapify(ready)
    running: dict[Future[Outcome], int] = {}

    def begin(k: int) -> None:
        observe(tasks[k], None)
        running[workers.submit(carry_out, tasks[k].job)] = k

    while ready or running:
        while ready and len(running) < workers.at_once:
            begin(heapq.heappop(ready)[1])
        for k in range(n_known):
            if len(running) >= workers.at_once:
                break
            job, waits = tasks[k].jobs[0], waits_for[k]
            # no more than one of a job's tasks at a time
            held_up = tasks[k].final and job not in outcomes and waits and max(waits) < n_known
            task = ahead.task(job) if held_up else None
            if task is not None:
                tasks.append(task)
                waits_for.append(set())
                unblocks[len(tasks) - 1].append(k)
                waits.add(len(tasks) - 1)
                begin(len(tasks) - 1)
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            k = running.pop(future)
            outcome = _outcome(future)
            for t in _all_after(k, unblocks) if isinstance(outcome, Failure) else [k]:
                if not tasks[t].final:
                    observe(tasks[t], outcome)
                elif tasks[t].jobs[0] not in outcomes:  # else failed already, by another of its stages
                    outcomes[tasks[t].jobs[0]] = outcome
                    observe(tasks[t], outcome)
            if isinstance(outcome, Failure):
                continue  # what waits for it never becomes ready
            ahead.made(tasks[k])
            for other in unblocks[k]:
                waits_for[other].discard(k)
                if not waits_for[other]:
                    heapq.heappush(ready, (-len(tasks[other].jobs), other))
    return [outcomes[k] for k in range(len(jobs))]


def _outcome(future: Future[Outcome]) -> Outcome | Failure:
    try:
        return future.result()
    except (InputError, CalibrationError) as error:
        return Failure(error)
    except OSError as error:  # a folder that may not be looked into, a name that is too long
        return Failure(InputError(of_system(error)))
    except MemoryError:
        return Failure(CalibrationError(OUT_OF_MEMORY))


def _all_after(k: int, unblocks: Mapping[int, Iterable[int]]) -> list[int]:
    reached, queue = {k: None}, [k]
    while queue:
        for other in unblocks.get(queue.pop(), ()):
            if other not in reached:
                reached[other] = None
                queue.append(other)
    return sorted(reached)
