"""What becomes of results when a store is damaged: every kind of accident, tried, counted: python -m benchmarks.damage

A case is bad where a result that is not the clean one was served (`wrong`), or a whole artifact was made again or a
run came to nothing (`lost`). Where only writing is tried, the stages answer with their known results.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.damage_cases import KINDS
from benchmarks.damage_store import Clean, Found, clean


@dataclass
class Tally:
    """Of one kind of case."""

    kind: str
    tried: int = 0
    healed: int = 0
    wrong: int = 0
    lost: int = 0
    first: str = ""  # what went wrong first

    def add(self, case: str, found: Found) -> None:
        self.tried += 1
        self.wrong += found.wrong
        self.lost += found.lost
        self.healed += not (found.wrong or found.lost)
        if (found.wrong or found.lost) and not self.first:
            self.first = f"{case}: {found.said}"


def main() -> None:
    wanted, bad = sys.argv[1:], 0
    memory = Path("/dev/shm")  # where there is no disk to wait for
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        known = clean(Path(name) / "clean")
        began = time.perf_counter()
        print(f"{'case':<58} {'tried':>6} {'healed':>6} {'wrong':>6} {'lost':>6}", flush=True)
        for kind, cases in KINDS.items():
            if wanted and not any(word in kind for word in wanted):
                continue
            folder = Path(name) / "case"
            folder.mkdir()
            tally = tallied(kind, cases, known, folder)
            bad += tally.wrong + tally.lost
            counts = f"{tally.tried:>6} {tally.healed:>6} {tally.wrong:>6} {tally.lost:>6}"
            print(f"{kind:<58} {counts}" + (f"   {tally.first}" if tally.first else ""), flush=True)
            _remove(folder)
    print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    sys.exit(bool(bad))


def tallied(
    kind: str, cases: Callable[[Clean, Path], Iterator[tuple[str, Found]]], known: Clean, folder: Path
) -> Tally:
    tally = Tally(kind)
    for case, found in cases(known, folder):
        tally.add(case, found)
    return tally


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
