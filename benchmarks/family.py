"""How often a fleet of equals has a unit named as out of family, and how often one with larger errors is named.

Fleets are drawn from identified virtual units with all their errors, and from the normal distribution with the same
posterior covariance. Ten minutes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.setup import spread
from kincal.identification.family import memberships
from kincal.identification.identification import Identification
from kincal.pipeline.run.runner import Run
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot

CASES = (
    ("gough_stewart", ("plan.poses=60",)),
    ("ups3_s", ("plan.poses=20", 'measure.channels=["orientation"]')),
    ("ups3_s", ()),
)
UNITS, FLEETS = 40, 300


def unit(job: tuple[str, tuple[str, ...], int, Path]) -> Identification:
    robot, settings, seed, store = job
    return Run(load_robot(robot, [*settings, f"measure.seed={seed}"]), Store(store)).until("identify")[0].shipped


def named(units: list[Identification], n: int, normal: bool, times: float, random: np.random.Generator) -> float:
    """The share of fleets of n in which any unit is named; or, where the first one's errors are larger, that one."""
    free = np.isfinite(units[0].tolerance)
    tolerance = units[0].tolerance[free]
    covariance = np.mean([u.covariance[np.ix_(free, free)] for u in units], axis=0)
    root = np.linalg.cholesky(np.diag(tolerance**2 * (1 + 1e-9)) - covariance)
    names = tuple(np.array(units[0].names)[free])
    count = 0
    for _ in range(FLEETS):
        if normal:
            changes = random.normal(size=(n, len(tolerance))) @ root.T
        else:
            changes = np.array([units[k].change[free] for k in random.choice(len(units), n, replace=False)])
        changes[0] += np.sqrt(times**2 - 1) * root @ random.normal(size=len(tolerance))
        fleet = [SimpleNamespace(names=names, tolerance=tolerance, change=c, covariance=covariance) for c in changes]
        out = [m.out_of_family for m in memberships(fleet)]  # pyright: ignore[reportArgumentType]
        count += bool(out[0] if times > 1 else any(out))
    return count / FLEETS


def main() -> None:
    print("design, settings, units: equals, normal; equals, virtual; one of 5 tolerances; of 3")
    with tempfile.TemporaryDirectory() as folder:
        for robot, settings in CASES:
            units = list(spread(unit, [(robot, settings, seed, Path(folder)) for seed in range(UNITS)]))
            for n in (5, 12, 24):
                random = np.random.default_rng(n)
                cells = [named(units, n, *case, random) for case in ((True, 1), (False, 1), (False, 5), (False, 3))]
                print(robot, *settings, n, *(f"{100 * cell:.1f} %" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
