"""The compensator at control rate: microseconds a command in C, samples a second in Python; ups3_s and a hexapod.

The correction of ups3_s is learned from 150 measured poses with the default settings. Poses are those of a smooth path,
100 samples a second of a few degrees each second, and random ones of the workspace.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import median_seconds
from kincal.identification.compiled import build, find_compiler
from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.code import sources
from kincal.pipeline.compensator.compensator import Compensator
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.pipeline.run.calibrated import calibrated
from kincal.pipeline.run.runner import Run
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import bounds, sample

ROBOTS = ("ups3_s", "gough_stewart")
_OPTIONS = ("-O3", "-std=c99")
_SAMPLES, _RATE = 4000, 100.0  # of the path, a second


def main() -> None:
    for robot in ROBOTS:
        with tempfile.TemporaryDirectory() as folder:
            session = Run(load_robot(robot), Store(Path(folder) / "store"))
            for method in ("geometric", "hybrid"):
                found = calibrated(session.robot.description, session.until, method)
                chosen = found.methods[method]
                assert isinstance(chosen, ModelMethod | HybridMethod)
                _measure(robot, method, chosen, found.channels, session, Path(folder))


def _measure(
    robot: str, name: str, method: ModelMethod | HybridMethod, channels: tuple[str, ...], session: Run, folder: Path
) -> None:
    workspace = session.robot.description.workspace
    began = time.perf_counter()
    compensator = Compensator.of(method, channels, workspace)
    solver = compensator.solver
    files = sources(compensator, "it", [robot])
    made, most = time.perf_counter() - began, compensator.most
    print(f"{robot}, {name}: code made in {made:.1f} s, {len(files['it.c']) / 1e3:.0f} kB, at most {most}", flush=True)
    chain = solver.robot.chain
    random = sample(workspace, chain.tool_axes, _SAMPLES, [0, 50])
    for what, u in (("path", _path(workspace, chain.tool_axes)), ("random poses", random)):
        readings = solver.robot.actuators.readings(inverse(chain, u).q[:, chain.actuated])
        desired = method.predict(readings)
        _in_c(f"{what}, C, gcc -O3", files, desired, folder)
        if what == "path":
            continue
        for where, quick in (("interpreted", solver), ("compiled", solver.compiled())):
            seconds = median_seconds(lambda: quick.commands(desired), 3)  # noqa: B023
            print(f"  {what}, Python, {where:<12} {_SAMPLES / seconds:10.0f} samples/s", flush=True)


def _in_c(what: str, files: dict[str, str], desired: Motion, folder: Path) -> None:
    compiler = find_compiler()
    if compiler is None:
        print(f"  {what}: there is no C compiler here")
        return
    for file, text in files.items():
        (folder / file).write_text(text, encoding="utf-8")
    build(compiler, [folder / "it.c", folder / "it_main.c"], folder / "it", *_OPTIONS)
    rows = np.column_stack([desired.translation, quaternions(desired.rotation)])
    text = "\n".join(" ".join(map(repr, map(float, row))) for row in rows)
    command = [str(folder / "it"), "--time", "25"]
    said = [subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout for _ in range(5)]
    # the least of five runs: other jobs share the processor
    for lines in zip(*(s.splitlines() for s in said), strict=True):
        best = min(lines, key=lambda line: float(line.split()[1]))
        print(f"  {what}: {best.split(' (')[0]}", flush=True)


def _path(workspace, axes: tuple[int, ...]) -> np.ndarray:
    """(_SAMPLES, 6) tool coordinates: sines of 5 to 9 s through two thirds of the workspace."""
    low, high = bounds(workspace).T
    t = np.arange(_SAMPLES)[:, None] / _RATE
    periods = 5 + 4 * np.arange(len(axes)) / max(len(axes) - 1, 1)
    u = np.zeros((_SAMPLES, 6))
    u[:, list(axes)] = (low + high) / 2 + (high - low) / 3 * np.sin(2 * np.pi * t / periods + np.arange(len(axes)))
    return u


if __name__ == "__main__":
    main()
