"""How far the jobs of a study are: a bar on stderr, or a callback."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from kincal.pipeline.interface.arguments import observer
from kincal.pipeline.interface.progress import err
from kincal.pipeline.run.fan_out import Failure, Outcome
from kincal.pipeline.run.task_graph import Job, Task

JobObserver: TypeAlias = "bool | Callable[[JobEvent], None]"


@dataclass(frozen=True)
class JobEvent:
    """A job of a study has ended: `done` of `total` have, and why it failed, where it did."""

    label: str
    done: int
    total: int
    error: str = ""


class JobProgress:
    """To be called as `run_all` observes; a context manager, so that an interrupted bar ends, too.

    named: one line a job in a terminal, too: they are robots.
    """

    def __init__(self, robot: str, labels: Mapping[Job, str], named: bool = False) -> None:
        self._robot, self._labels, self._named = robot, labels, named
        self._running: dict[Task, TaskID] = {}
        self._done = self._failed = 0
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, TimeRemainingColumn(), TextColumn("{task.fields[now]}"), console=err)
        self._row = self._bar.add_task(robot, total=len(labels), now="")

    def __enter__(self) -> JobProgress:
        if err.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if err.is_terminal:
            self._bar.stop()

    def __call__(self, task: Task, outcome: Outcome | Failure | None) -> None:
        """Show a task that begins (outcome: None) or has ended."""
        if outcome is None:
            label = self._labels[task.job] if task.final else _beginning(task)
            self._running[task] = self._bar.add_task(f"  {label}", total=None, now="")
            return
        if task in self._running:
            self._bar.remove_task(self._running.pop(task))
        for warning in () if isinstance(outcome, Failure) else outcome.damaged:
            self._say(f"warning: {warning}; set aside, it runs again", "yellow")
        if not task.final:
            if not err.is_terminal:
                self._say(f"{self._robot} {_beginning(task)}  {_what(outcome)}", "dim")
            return
        self._done += 1
        self._failed += isinstance(outcome, Failure)
        self._bar.update(self._row, completed=self._done, now=f"{self._failed} failed" if self._failed else "")
        if isinstance(outcome, Failure) or self._named or not err.is_terminal:
            where = f"{self._robot} {self._done}/{len(self._labels)} {self._labels[task.job]}"
            self._say(f"{where}  {_what(outcome)}", "red" if isinstance(outcome, Failure) else "")

    def _say(self, line: str, style: str) -> None:
        err.print(Text(" ".join(line.split("\n")), style=style), soft_wrap=True)


def _beginning(task: Task) -> str:
    n = len(task.jobs)
    return f"{task.job.until}, shared by {n} jobs" if n > 1 else f"{task.job.until}, ahead of the rest"


def _what(outcome: Outcome | Failure) -> str:
    if isinstance(outcome, Failure):
        return f"failed: {outcome.error}"
    ran = [p for p in outcome.passed if p.state == "ran"]
    if not ran:
        return "cached"
    seconds = sum(p.seconds or 0.0 for p in ran)
    return f"{seconds:.2f} s ({', '.join(p.stage for p in ran)})"


class JobLog:
    """To be called as `run_all` observes, without a bar: tells a callback of the user's, if there is one."""

    def __init__(self, labels: Mapping[Job, str], tell: Callable[[JobEvent], None] | None) -> None:
        self._labels, self._tell, self._done = labels, tell, 0

    def __enter__(self) -> JobLog:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __call__(self, task: Task, outcome: Outcome | Failure | None) -> None:
        """Report a job that has ended."""
        if not task.final or outcome is None:
            return
        self._done += 1
        if self._tell is not None:
            error = str(outcome.error) if isinstance(outcome, Failure) else ""
            self._tell(JobEvent(self._labels[task.job], self._done, len(self._labels), error))


def job_observer(
    progress: JobObserver, robot: str, labels: Mapping[Job, str], named: bool = False
) -> JobProgress | JobLog:
    """True stands for a bar on stderr. A context manager, to be called as `run_all` observes."""
    observer(progress)
    if progress is True:
        return JobProgress(robot, labels, named)
    return JobLog(labels, progress or None)
