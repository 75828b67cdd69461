"""What many jobs share, as tasks that wait for each other."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from pydantic_core import to_jsonable_python

from kincal.pipeline.run.stage import all_stages, needed
from kincal.pipeline.store.digests import digest
from kincal.urdf.description import RobotDescription

Prefix = dict[str, str]  # {stage: digest of the settings of it and of all that it rests on}, in running order


@dataclass(frozen=True)
class Job:
    """A robot's way through the stages as a plain value: any worker that sees the store can go it."""

    robot: str  # name, path to a robot.toml, or FLEET.toml:UNIT
    overrides: tuple[str, ...]  # table.key=value, as of --set
    store: Path
    until: str
    command: str = ""
    noted: bool = False  # as `kincal run` does: what the robot used last is noted down, and its report published


@dataclass(frozen=True)
class Task:
    """A job, or stages at the beginning of one, or those that several of them (`jobs`) share."""

    job: Job
    jobs: tuple[int, ...]
    final: bool


def shared_tasks(jobs: Sequence[Job], prefixes: Sequence[Prefix]) -> tuple[list[Task], list[set[int]]]:
    """The tasks, shared beginnings before the jobs, and for each the tasks that it waits for.

    A stage's result is shared by the jobs whose settings agree in it and in all that it rests on. It is a task of
    its own where ways part after it; else it runs along with the one stage that follows.
    """
    users, follow = defaultdict(list), defaultdict(set)
    for k, prefix in enumerate(prefixes):
        for stage, key in prefix.items():
            users[key].append(k)
            for source in _direct(stage):
                follow[prefix[source]].add(key)
    number, tasks, waits_for = {}, [], []
    for k, prefix in enumerate(prefixes):
        for stage, key in prefix.items():
            if key not in number and len(users[key]) > 1 and len(follow[key]) != 1:
                number[key] = len(tasks)
                beginning = replace(jobs[k], until=stage)
                tasks.append(Task(beginning, tuple(users[key]), final=False))
                before = (prefix[s.name] for s in needed(stage) if s.name != stage)
                waits_for.append({number[other] for other in before if other in number})
    for k, prefix in enumerate(prefixes):
        tasks.append(Task(jobs[k], (k,), final=True))
        waits_for.append({number[key] for key in prefix.values() if key in number})
    return tasks, waits_for


def prefix_of(until: str, robot: RobotDescription) -> Prefix:
    """Of a job that goes as far as `until`."""
    prefix: Prefix = {}
    for stage in needed(until):
        settings = {name: to_jsonable_python(getattr(robot, name), by_alias=True) for name in stage.settings}
        prefix[stage.name] = digest([stage.name, settings, [prefix[source] for source in stage.inputs.values()]])
    return prefix


@lru_cache
def _direct(stage: str) -> frozenset[str]:
    """The stage's inputs, without those that another input rests on anyway."""
    inputs = set(all_stages()[stage].inputs.values())
    deeper = {before.name for source in inputs for before in needed(source) if before.name != source}
    return frozenset(inputs - deeper)


class Ahead:
    """Which of a job's own stages could run, while what it shares is not all there yet."""

    def __init__(self, jobs: Sequence[Job], prefixes: Sequence[Prefix]) -> None:
        self._jobs, self._prefixes = jobs, prefixes
        users = Counter(key for prefix in prefixes for key in prefix.values())
        self._shared = {key for key, n in users.items() if n > 1}
        self._made: set[str] = set()

    def made(self, task: Task) -> None:
        prefix = self._prefixes[task.jobs[0]]
        self._made |= {prefix[stage.name] for stage in needed(task.job.until)}

    def task(self, k: int) -> Task | None:
        """The most of job k's own stages that rest on nothing that is still to be made elsewhere."""
        prefix, farthest = self._prefixes[k], (0, "")
        for name in prefix:
            lacking = {prefix[stage.name] for stage in needed(name)} - self._made
            if not lacking & self._shared:
                farthest = max(farthest, (len(lacking), name))
        return Task(replace(self._jobs[k], until=farthest[1]), (k,), final=False) if farthest[0] else None
