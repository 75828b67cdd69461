"""Whole commands as a user runs them: wall seconds and peak memory of the process."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time

_OWN = """
import time
import kincal.pipeline.commands.app
from pathlib import Path
from kincal.pipeline.store.store import Store
from kincal.pipeline.run.runner import Run
from kincal.urdf.description import load_robot
robot = load_robot("ups3_s")
began = time.perf_counter()
Run(robot, Store(Path(".kincal"))).until("evaluate", "report")
print(time.perf_counter() - began)
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for what, arguments, runs in (
            ("cold `kincal run ups3_s`", ["run", "ups3_s"], 1),
            ("cached `kincal run ups3_s`", ["run", "ups3_s"], 5),
            ("cached `kincal inspect ups3_s`", ["inspect", "ups3_s"], 5),
            ("cached `kincal compare ups3_s`", ["compare", "ups3_s"], 5),
            ("cached `kincal status ups3_s`", ["status", "ups3_s"], 5),
        ):
            found = [_run(arguments, folder) for _ in range(runs)]
            seconds = statistics.median(f[0] for f in found)
            print(f"{what:<66} {seconds:10.2f} s   peak memory {max(f[1] for f in found):.0f} MB", flush=True)
        found = [_seconds_of_the_cache(folder) for _ in range(5)]
        what = "of which the cache: keys, manifests, digests, two results read"
        print(f"{what:<66} {1e3 * statistics.median(found):10.0f} ms", flush=True)


def _seconds_of_the_cache(folder: str) -> float:
    done = subprocess.run([sys.executable, "-c", _OWN], cwd=folder, capture_output=True, text=True, check=True)
    return float(done.stdout)


def _run(arguments: list[str], folder: str) -> tuple[float, float]:
    command = [sys.executable, "-m", "kincal", *arguments]
    began = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - began
    if status:
        raise SystemExit(f"{' '.join(command)} failed")
    return seconds, usage.ru_maxrss / 1024


if __name__ == "__main__":
    main()
