"""Medians of repeated runs after a warm-up, and rows that read alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def median_seconds(call: Callable[[], object], runs: int = 5) -> float:
    call()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def row(what: str, seconds: float, note: str = "") -> None:
    print(f"{what:<66} {1e3 * seconds:10.1f} ms  {note}", flush=True)
