"""How far a calibration is: lines on stderr, a callback, and the log.

What a user should know of the data goes to the logger `kincal.pipeline` as a warning, whoever calls.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from rich.console import Console
from rich.text import Text

from kincal.pipeline.interface.arguments import observer
from kincal.pipeline.run.changes import FIRST

if TYPE_CHECKING:
    from rich.status import Status

    from kincal.pipeline.run.runner import Event

StageObserver: TypeAlias = "bool | Callable[[Event], None]"

err = Console(stderr=True, highlight=False)
logger = logging.getLogger("kincal.pipeline")


def stage_observer(progress: StageObserver, robot: str) -> Callable[[Event], None]:
    """Tells the log, and whom the user names; True: lines on stderr, live in a terminal. Raises InputError."""
    observer(progress)
    shown = StageProgress(robot) if progress is True else progress or None

    def observe(event: Event) -> None:
        if shown is not None:
            shown(event)
        if event.state == "noted":
            logger.warning("%s", event.why)
        elif event.state == "damaged":
            logger.warning("%s; set aside, %s runs again", event.why, event.stage)
        else:
            logger.debug("%s %s %s", robot, event.stage, event.state)

    return observe


class StageProgress:
    """A line a stage."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._live: Status | None = None
        self._shown: set[str] = set()  # stages: that one is still cached need not be repeated

    def __call__(self, event: Event) -> None:
        """Show what a stage does."""
        why = f"  ({event.why})" if event.why and event.why != FIRST else ""
        label = f"{self._robot} {event.stage:<10}"
        if event.state == "running":
            if err.is_terminal:
                self._live = err.status(Text(f"{label} running{why}"))
                self._live.start()
            return
        if self._live is not None:
            self._live.stop()
            self._live = None
        if event.state == "ran" or (event.state == "cached" and event.stage not in self._shown):
            self._shown.add(event.stage)
            seconds = "" if event.seconds is None else f" {event.seconds:6.2f} s"
            style = "dim" if event.state == "cached" else ""
            err.print(Text(f"{label} {event.state:<6}{seconds}{why}", style=style), soft_wrap=True)
