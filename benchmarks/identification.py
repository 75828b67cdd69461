"""One identification of all parameters, beside scipy's least squares with finite differences on the same residuals.

The peers minimise the same sum (checked before the clock runs), from the same start. `pose by pose` is what one would
write today over Pinocchio (`benchmarks.pinocchio_peer`); `batched` borrows kincal's loop closure of all poses at once.
Then time and memory against the number of poses.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

import numpy as np
from scipy.optimize import least_squares

from benchmarks.pinocchio_peer import residuals, solve
from benchmarks.setup import bench, measured_robot
from benchmarks.timing import median_seconds, row
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate, estimate_parameters, register
from kincal.identification.measurements import Measurements

ROBOTS = ("ups3_s", "gough_stewart", "jugglebot", "ur10")
POSES = 150
PATIENCE = 600  # seconds for a peer
SCALING = (100, 1000, 10_000, 100_000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=ROBOTS, metavar="ROBOT", help=f"default: {' '.join(ROBOTS)}")
    parser.add_argument("--quick", action="store_true", help="kincal and the batched peer of the first robot alone")
    parser.add_argument("--scaling", action="store_true", help="time and memory against the number of poses alone")
    parser.add_argument("--child", nargs=2, metavar=("WHAT", "OF"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        what, of = options.child
        print(json.dumps(_timed_peer(of) if what == "peer" else _timed_poses(int(of))))
        return
    if not options.scaling:
        for name in options.robots:
            _beside_peers(name, batched=name == options.robots[0], pose_by_pose=not options.quick)
    if not options.quick:
        for n in SCALING:
            found = _child("poses", str(n), None)
            per_pose = 1e3 * found["seconds"] / n
            row(
                f"identification, {n} poses (ups3_s)",
                found["seconds"],
                f"{per_pose:.3f} ms a pose, {found['iterations']} iterations, peak memory {found['megabytes']:.0f} MB",
            )


def _beside_peers(name: str, batched: bool, pose_by_pose: bool) -> None:
    errors, measured = measured_robot(name, POSES)
    ours = estimate_parameters(errors, measured)
    seconds = median_seconds(lambda: estimate_parameters(errors, measured))
    row(
        f"identification, {POSES} poses, {len(errors.parameters)} parameters ({name})",
        seconds,
        f"cost {ours.cost:.6f} in {ours.iterations} iterations",
    )
    if batched:
        registered = register(errors, measured)
        began = time.perf_counter()
        found = least_squares(lambda p: _batched(errors, measured, p, registered), registered.p, x_scale=_scale(errors))
        _peer_row("  peer: scipy over kincal's batched loop closure", time.perf_counter() - began, found.cost, seconds)
    if not pose_by_pose:
        return
    what = "  peer: scipy over Pinocchio, pose by pose"
    try:
        found = _child("peer", name, PATIENCE)
    except subprocess.TimeoutExpired:
        print(f"{what:<66} over {PATIENCE} s: more than {PATIENCE / seconds:.0f} times as long", flush=True)
        return
    _peer_row(what, found["seconds"], found["cost"], seconds)


def _peer_row(what: str, seconds: float, cost: float, ours: float) -> None:
    row(what, seconds, f"cost {cost:.6f}; {seconds / ours:.0f} times as long")


def _child(what: str, of: str, timeout: float | None) -> dict:
    """In a process of its own: it can be stopped, and its peak memory is its own."""
    command = [sys.executable, "-m", "benchmarks.identification", "--child", what, of]
    return json.loads(subprocess.run(command, check=True, timeout=timeout, capture_output=True, text=True).stdout)


def _timed_peer(name: str) -> dict:
    errors, measured = measured_robot(name, POSES)
    registered = register(errors, measured)
    random = np.random.default_rng(0)
    for p in (registered.p, registered.p + 0.1 * random.normal(size=len(registered.p)) * _scale(errors)):
        apart = np.abs(residuals(errors, measured, p, registered.q) - _batched(errors, measured, p, registered)).max()
        size = np.abs(_batched(errors, measured, p, registered)).max()
        if apart > 1e-9 * max(1.0, size):
            raise SystemExit(f"{name}: the peer's residuals differ by {apart:.1e}")
    began = time.perf_counter()
    found = solve(errors, measured, registered)
    return {"seconds": time.perf_counter() - began, "cost": found.cost}


def _timed_poses(n: int) -> dict:
    at = bench("ups3_s", ("orientation",))
    _, robot = at.built(0)
    measured = at.measured(robot, at.sites(n, [0, 51]).readings, 0)
    began = time.perf_counter()
    found = estimate_parameters(at.model, measured)
    seconds = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"seconds": seconds, "iterations": found.iterations, "megabytes": peak}


def _batched(errors: ErrorModel, measured: Measurements, p: np.ndarray, registered: Estimate) -> np.ndarray:
    """The same residuals with kincal's loop closure: what is left to compare is derivatives and linear algebra."""
    robot = errors.robot(p)
    closure = robot.close(measured.readings, registered.q)
    return np.concatenate([errors.residual(robot, closure.q, measured).ravel(), p / errors.parameters.tolerance])


def _scale(errors: ErrorModel) -> np.ndarray:
    return np.where(errors.parameters.flat, 1e-2, errors.parameters.tolerance)


if __name__ == "__main__":
    main()
