"""The five estimators side by side on virtual robots, geometric errors and noise alone: medians over robots.

Errors are on fresh poses against the noise-free truth: `held out`, poses like the measured ones; `whole`, of the whole
workspace; the mean angle of rotation (of the vertical, for tilt alone) [deg], and of position [mm]. Parameter errors
are root mean squares in tolerances: over all geometric parameters, and over the combinations that the data can tell.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from benchmarks.setup import Bench, bench, spread
from kincal.identification.accuracy import score
from kincal.identification.collinearity import collinearity
from kincal.identification.error_model import BuiltRobot
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.expected import Sites
from kincal.identification.identifiability import identifiability
from kincal.identification.measurements import Measurements
from kincal.identification.shrinkage import N_FRAMES, Linear, identifiable
from kincal.urdf.description import Identify
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import exp

FRESH = 200
OUTLIERS = 0.05  # share of the poses
WRONG = 30.0  # sigmas that they are off by, in a random direction


@dataclass(frozen=True)
class Case:
    robot: str
    channels: tuple[str, ...]
    axes: tuple[int, ...] | None = None  # those that move; None: all

    @property
    def bench(self) -> Bench:
        return bench(self.robot, self.channels)


CASES = {
    "ups3_s, orientation, the whole workspace": Case("ups3_s", ("orientation",)),
    "jugglebot, orientation and position, the whole workspace": Case("jugglebot", ("orientation", "position")),
    "ups3_s, tilt alone, yaw fixed at 0": Case("ups3_s", ("tilt",), axes=(3, 4)),
}
ESTIMATORS = {
    "least_squares": Identify(estimator="least_squares"),
    **{
        f"{name}, {how}": Identify(estimator=name, shrinkage=how)
        for name in ("truncated_svd", "ridge", "liu")
        for how in ("gcv", "kfold")
    },
    "map": Identify(),
    "map, gcv": Identify(shrinkage="gcv"),
    "map, kfold": Identify(shrinkage="kfold"),
}
LOSSES = {loss: Identify(loss=loss) for loss in ("gaussian", "huber", "cauchy")}
NAMES = ("held_out", "whole")


@dataclass(frozen=True)
class Found:
    """One estimate of one robot."""

    held_out: tuple[float | None, float | None]  # mean [deg], [mm]
    whole: tuple[float | None, float | None]
    parameters: float  # in tolerances
    combinations: float
    shrinkage: float


@dataclass(frozen=True)
class Result:
    """All estimates of one robot; a text says why there is none."""

    condition: float  # number of the identifiable subspace
    index: float  # the largest condition index
    rank: int
    nominal: Found
    estimates: dict[str, Found | str]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="words of their titles; default: all")
    parser.add_argument("--robots", type=int, default=20, help="virtual robots a table (20)")
    parser.add_argument("--poses", type=int, nargs="+", default=(50, 12), help="50 12")
    options = parser.parse_args()
    for case in CASES:
        if options.cases and not any(word in case for word in options.cases):
            continue
        for n in options.poses:
            found = list(spread(estimated, [(case, n, seed) for seed in range(options.robots)]))
            _show(f"{case}, {n} poses", found, ESTIMATORS)
        n = max(options.poses)
        for share in (0.0, OUTLIERS):
            found = list(spread(robust, [(case, n, seed, share) for seed in range(options.robots)]))
            _show(f"map by its loss: {case}, {n} poses, {100 * share:.0f} % outliers", found, LOSSES)


def estimated(job: tuple[str, int, int]) -> Result:
    case, n, seed = job
    return _result(CASES[case], n, seed, ESTIMATORS, 0.0)


def robust(job: tuple[str, int, int, float]) -> Result:
    case, n, seed, outliers = job
    return _result(CASES[case], n, seed, LOSSES, outliers)


def _result(case: Case, n: int, seed: int, ways: dict[str, Identify], outliers: float) -> Result:
    """Virtual robot `seed`, identified from n poses in each of these ways."""
    at = case.bench
    truth, robot = at.built(seed)
    measured = at.measured(robot, at.sites(n, [seed, 41], case.axes).readings, seed)
    if outliers:
        measured = _spoilt(measured, outliers, seed)
    fresh = [at.sites(FRESH, [seed, 42], axes) for axes in (case.axes, None)]
    registered = register(at.model, measured)
    parameters = at.model.parameters
    tolerance = parameters.tolerance[:-N_FRAMES]
    within = identifiable(Linear(registered.triangle, measured.rows), tolerance)

    def found(p: np.ndarray, shrinkage: float) -> Found:
        identified = at.model.robot(p)
        errors = (p - truth)[:-N_FRAMES] / tolerance
        return Found(
            *(_scored(at, robot, identified, sites) for sites in fresh),
            parameters=_rms(errors),
            combinations=_rms(within @ errors),
            shrinkage=shrinkage,
        )

    estimates: dict[str, Found | str] = {}
    for name, settings in ways.items():
        try:
            estimate = estimate_parameters(at.model, measured, settings, registered)
            estimates[name] = found(estimate.p, estimate.shrinkage)
        except (CalibrationError, InputError) as error:
            estimates[name] = str(error)
    seen = identifiability(registered.triangle[:, :-1], parameters, measured.rows)
    indexes = collinearity(registered.triangle, measured.rows, parameters).condition_indexes
    return Result(seen.condition_number, float(indexes[-1]), seen.rank, found(registered.p, 0.0), estimates)


def _spoilt(measured: Measurements, share: float, seed: int) -> Measurements:
    """With a share of the poses off by WRONG sigmas in a random direction, in every channel."""
    random = np.random.default_rng([seed, 43])
    rows = random.choice(len(measured), round(share * len(measured)), replace=False)
    values = {}
    for channel in measured.channels:
        readings, sigma = measured.values[channel].copy(), measured.std[channel][rows]
        wrong = random.normal(size=(len(rows), readings.shape[-1]))
        wrong *= (WRONG * sigma / np.linalg.norm(wrong, axis=1))[:, None]
        readings[rows] = readings[rows] @ exp(wrong) if channel == "orientation" else readings[rows] + wrong
        values[channel] = readings
    return measured.replaced(**values)


def _scored(at: Bench, robot: BuiltRobot, identified: BuiltRobot, fresh: Sites) -> tuple[float | None, float | None]:
    actual, predicted = (built.measured(built.close(fresh.readings).pose) for built in (robot, identified))
    scored = score(actual, predicted, at.channels)
    return scored.mean_deg, scored.mean_mm


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _show(title: str, results: list[Result], ways: dict[str, Identify]) -> None:
    condition, index, rank = (np.median([getattr(r, name) for r in results]) for name in ("condition", "index", "rank"))
    print(f"\n{title}; {len(results)} robots")
    print(f"rank {rank:.0f}, condition number {condition:.3g}, largest condition index {index:.3g}")
    units = [k for k in (0, 1) if results[0].nominal.held_out[k] is not None]
    names = NAMES[: 1 + (results[0].nominal.whole != results[0].nominal.held_out)]
    heads = [f"{name.replace('_', ' ')} [{('deg', 'mm')[k]}]" for k in units for name in names]
    print(
        f"{'':<22}{''.join(f'{head:>16}' for head in heads)}"
        f"{'parameters':>12}{'combinations':>14}{'chosen':>11}{'failures':>10}"
    )
    rows = {"nominal": [r.nominal for r in results]} | {name: [r.estimates[name] for r in results] for name in ways}
    for name, found in rows.items():
        good = [f for f in found if isinstance(f, Found)]
        if not good:
            print(f"{name:<22}{'none':>16}   {found[0]}", flush=True)
            continue
        cells = [np.median([getattr(f, at)[k] for f in good]) for k in units for at in names]
        shown = "".join(f"{c:>16.6f}" for c in cells)
        parameters, combinations, chosen = (
            np.median([getattr(f, at) for f in good]) for at in ("parameters", "combinations", "shrinkage")
        )
        chosen_shown = f"{chosen:.3g}" if name != "nominal" else ""
        failures = len(found) - len(good)
        print(f"{name:<22}{shown}{parameters:>12.3f}{combinations:>14.3f}{chosen_shown:>11}{failures:>10}", flush=True)
        for why in sorted({f for f in found if isinstance(f, str)}):
            print(f"    {why}")


if __name__ == "__main__":
    main()
