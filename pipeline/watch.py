"""How far a long computation is, for whoever watches: whoever computes reports a share, and need not know to whom."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_WATCHER: ContextVar[Callable[[float], None] | None] = ContextVar("watcher", default=None)


def advanced(share: float) -> None:
    """Report the share (0 .. 1) of the work that is done."""
    watcher = _WATCHER.get()
    if watcher is not None:
        watcher(share)


@contextmanager
def watched(watcher: Callable[[float], None]) -> Iterator[None]:
    """Within: `watcher` is called with shares."""
    token = _WATCHER.set(watcher)
    try:
        yield
    finally:
        _WATCHER.reset(token)
