"""Accuracy of the six methods on virtual 3-UPS/S platforms: medians over ten seeds (robot, noise, split, networks).

Each row is the mean volumetric error on 500 fresh poses against the noise-free truth, in degrees.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.setup import spread
from kincal.pipeline.run.runner import Run
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot

SEEDS = range(10)
GEOMETRIC = ["measure.errors.elastic=false", "measure.errors.screw=false"]
CASES = {
    "default: inclinometer and heading streams, 150 poses": [],
    "the same, 50 poses": ["plan.poses=50"],
    "the same, 10 poses": ["plan.poses=10"],
    "tracker-like orientation, 150 poses": ['measure.channels=["orientation"]'],
    "the same, geometric errors only": ['measure.channels=["orientation"]', *GEOMETRIC],
    "streams, geometric errors only, 50 poses": [*GEOMETRIC, "plan.poses=50"],
    "streams, geometric errors only, 10 poses": [*GEOMETRIC, "plan.poses=10"],
    "inclinometer alone (scored on tilt), 150 poses": ['measure.channels=["tilt"]'],
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for case, settings in CASES.items():
            if sys.argv[1:] and not any(word in case for word in sys.argv[1:]):
                continue
            found = list(spread(_compare, [(Path(folder), [*settings, f"seed={seed}"]) for seed in SEEDS]))
            print(f"\n{case}\n{'method':<22}{'mean':>9}{'max':>9}   mean after compensation", flush=True)
            rows = [[f.raw_nominal, *f.methods] for f in found]
            for k, first in enumerate(rows[0]):
                mean, largest = (
                    statistics.median(getattr(r[k], name) for r in rows) for name in ("mean_deg", "max_deg")
                )
                loop = statistics.median(f.closed_loop[k - 1].mean_deg for f in found) if k else None
                print(
                    f"{first.name:<22}{mean:9.5f}{largest:9.5f}   {'' if loop is None else f'{loop:.5f}'}", flush=True
                )


def _compare(job: tuple[Path, list[str]]):
    store, settings = job
    return Run(load_robot("ups3_s", settings), Store(store)).until("evaluate")[0]


if __name__ == "__main__":
    main()
