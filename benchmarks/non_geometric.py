"""Which non-geometric errors does each method remove? Virtual 3-UPS/S platforms with one kind of error at a time.

python -m benchmarks.non_geometric [--seeds 5] [--] [word of a case] ..

Each row is a median over seeds 200, 201, .. (robot, noise, split, networks) of the mean error [deg] on 500 fresh poses
against the noise-free truth; a tracker measures 150 poses, geometric errors are always on. `left` is what a method
leaves of that which the error adds to `geometric` beyond a purely geometric robot. The error counts as

    removed   where less than 30 % are left, or less than 10 % of the purely geometric robot's own error
    partly    where less than 90 % are left
    none      elsewhere
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path

from kincal.pipeline.results import Comparison
from kincal.pipeline.run.runner import Run
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot

FIRST_SEED = 200
ALONE = ('measure.channels=["orientation"]', "plan.poses=150")
SCREW = {"screw": "true", "screw_quadratic_per_m": 0.0}
REFERENCE = "purely geometric"
CASES = {
    "elastic legs": {"elastic": "true"},
    "screw, long period (80 mm)": {**SCREW, "screw_period_mm": 80.0},
    "screw, short period (3 mm)": {**SCREW, "screw_period_mm": 3.0},
    "clearance 0.02 mm": {"clearance_mm": 0.02},
    "backlash 0.02 mm": {"backlash_mm": 0.02},
    "thermal growth 0.05 mm": {"thermal_growth_mm": 0.05},
    "cross-axis 1e-3": {"cross_axis": 1e-3},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="cases that hold one of these words; default: all")
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + asked.seeds)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        reference = _mean_errors(store, {}, seeds)
        print(f"{REFERENCE}, seeds {seeds[0]} to {seeds[-1]} [deg]")
        for method, mean in reference.items():
            print(f"{method:<22}{mean:9.5f}")
        for case, errors in CASES.items():
            if not asked.words or any(word in case for word in asked.words):
                _print_block(case, _mean_errors(store, errors, seeds), reference["geometric"])


def _mean_errors(store: Store, errors: dict, seeds: range) -> dict[str, float]:
    """{method: median over seeds of its mean error [deg]} where `errors` are the only ones beside geometry."""
    sizes = {"elastic": "false", "screw": "false"} | errors
    settings = [*ALONE, *(f"measure.errors.{key}={value}" for key, value in sizes.items())]
    found = [_compare(store, [*settings, f"seed={seed}"]) for seed in seeds]
    return {
        first.name: statistics.median(f.methods[k].mean_deg for f in found)  # pyright: ignore[reportArgumentType]
        for k, first in enumerate(found[0].methods)
    }


def _compare(store: Store, settings: list[str]) -> Comparison:
    return Run(load_robot("ups3_s", settings), store).until("evaluate")[0]


def _print_block(case: str, means: dict[str, float], floor: float) -> None:
    added = means["geometric"] - floor
    print(f"\n{case}: adds {added:.5f} to geometric\n{'method':<22}{'mean':>9}{'left':>8}   verdict")
    for method, mean in means.items():
        left = (
            f"{(mean - floor) / added:8.0%}" if added > 0.1 * floor else f"{'-':>8}"
        )  # else there is nothing to share
        print(f"{method:<22}{mean:9.5f}{left}   {_verdict(mean - floor, added, floor)}", flush=True)


def _verdict(excess: float, added: float, floor: float) -> str:
    if excess < max(0.3 * added, 0.1 * floor):
        return "removed"
    return "partly" if excess < 0.9 * added else "none"


if __name__ == "__main__":
    main()
