"""`python -m tests.fuzz --cases 20000`: a table of what came of spoiled files, target by target."""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path

from tests.fuzz.campaign import campaign
from tests.fuzz.case import Result
from tests.fuzz.commands import commands
from tests.fuzz.targets import TARGETS


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--commands", type=int, default=0, help="of the real command, a process each")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--target", action="append", help="of the targets' names; may be repeated")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-defects"), help="the folder of failing files")
    given = parser.parse_args()
    targets = [t for t in TARGETS if not given.target or any(word in t.name for word in given.target)]
    began = time.monotonic()
    results = campaign(given.cases, given.workers, targets, given.keep.absolute(), _progress)
    results += commands(given.commands, _progress)
    table(results)
    print(f"{len(results)} cases in {time.monotonic() - began:.0f} s")
    sys.exit(any(r.outcome == "defect" for r in results))


def _progress(result: Result) -> None:
    if result.outcome == "defect":
        print(
            f"{result.target}, case {result.number}: {' '.join(result.said.split())[:250]}", file=sys.stderr, flush=True
        )


def table(results: list[Result]) -> None:
    of = defaultdict(list)
    for result in results:
        of[result.target].append(result)
    print("| target | cases | accepted | refused | defects | slowest [s] | largest [MB] |")
    print("|---|---|---|---|---|---|---|")
    for name, own in [*of.items(), ("all", results)]:
        count = {o: sum(r.outcome == o for r in own) for o in ("accepted", "refused", "defect")}
        slowest, largest = max(r.seconds for r in own), max(r.megabytes for r in own)
        print(f"| {name} | {len(own)} | {' | '.join(map(str, count.values()))} | {slowest:.2f} | {largest:.0f} |")


if __name__ == "__main__":
    main()
