"""How far many jobs are: a bar and a row a running job in a terminal, else plain lines; by the parent, on stderr."""

from __future__ import annotations

from collections.abc import Mapping

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

from kincal.pipeline.commands.console import err
from kincal.pipeline.run.fan_out import Failure, Job, Outcome, Task


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
        if outcome is None:
            what = self._labels[task.job] if task.final else _beginning(task)
            self._running[task] = self._bar.add_task(f"  {what}", total=None, now="")
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
