"""How far a calibration is: lines on stderr, a callback, and the log.

What a user should know of the data goes to the logger `kincal.pipeline` as a warning, whoever calls.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from rich.console import Console
from rich.text import Text

from kincal.pipeline.interface.arguments import observer
from kincal.pipeline.run.changes import FIRST

if TYPE_CHECKING:
    from kincal.pipeline.run.runner import Event

StageObserver: TypeAlias = "bool | Callable[[Event], None]"

err = Console(stderr=True, highlight=False)
logger = logging.getLogger("kincal.pipeline")
_OFTEN_S = 0.2  # between two updates of a line


def stage_observer(progress: StageObserver, robot: str) -> Callable[[Event], None]:
    """Tells the log, and whom the user names; True: lines on stderr, live in a terminal. Raises InputError."""
    observer(progress)
    shown = StageProgress(robot) if progress is True else progress or None

    def observe(event: Event) -> None:
        if shown is not None and (event.state != "advanced" or progress is True):  # callers get what begins and ends
            shown(event)
        if event.state == "noted":
            logger.warning("%s", event.why)
        elif event.state == "damaged":
            logger.warning("%s; set aside, %s runs again", event.why, event.stage)
        else:
            logger.debug("%s %s %s", robot, event.stage, event.state)

    return observe


class Clock:
    """A line that lives in a terminal while something runs, with the time left where that is known."""

    def __init__(self, label: str) -> None:
        self._label, self._began, self._shown = label, 0.0, 0.0
        self._status = err.status(Text(label)) if err.is_terminal else None

    def start(self) -> None:
        """Show it."""
        self._began = time.perf_counter()
        if self._status is not None:
            self._status.start()

    def advance(self, share: float) -> None:
        """Show how much is done, and how many seconds are left at this pace."""
        now = time.perf_counter()
        if self._status is None or not 0 < share < 1 or now - self._shown < _OFTEN_S:
            return
        self._shown, left = now, (now - self._began) * (1 - share) / share
        self._status.update(Text(f"{self._label} {100 * share:.0f} %, {left:.0f} s left"))

    def stop(self) -> None:
        """Take it away."""
        if self._status is not None:
            self._status.stop()


class StageProgress:
    """A line a stage."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._clock: Clock | None = None
        self._shown: set[str] = set()  # stages: that one is still cached need not be repeated

    def __call__(self, event: Event) -> None:
        """Show what a stage does."""
        why = f"  ({event.why})" if event.why and event.why != FIRST else ""
        label = f"{self._robot} {event.stage:<10}"
        if event.state == "running":
            self._clock = Clock(f"{label} running{why}")
            self._clock.start()
            return
        if self._clock is not None:
            if event.state == "advanced":
                self._clock.advance(event.share or 0.0)
                return
            self._clock.stop()
            self._clock = None
        if event.state == "ran" or (event.state == "cached" and event.stage not in self._shown):
            self._shown.add(event.stage)
            seconds = "" if event.seconds is None else f" {event.seconds:6.2f} s"
            style = "dim" if event.state == "cached" else ""
            err.print(Text(f"{label} {event.state:<6}{seconds}{why}", style=style), soft_wrap=True)
