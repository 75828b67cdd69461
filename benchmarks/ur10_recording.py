"""The real UR10 of Landgraf et al. (2021), measured by laser tracker: errors on held-out poses, means over five splits.

Of each series 300 poses train, drawn with the split's seed; all others are held out. `estimated sigmas`: as if nobody
had given any, by variance components of the 300.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.setup import spread
from kincal.identification.accuracy import score
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurement_table import read_table
from kincal.identification.measurements import Measurements, to_measurements
from kincal.pipeline.stages.drawing import model_stage
from kincal.urdf.description import ROBOTS, Identify, load_robot
from kincal.urdf.errors import CalibrationError

DATA = Path(__file__).parents[2] / "shared" / "data" / "ipa_ur10_tmac"
SERIES = {
    "C, random poses": "Series_C/measurements_random_poses.csv",
    "D, ISO cubes": "Series_D/measurements_iso_cubes.csv",
}
TRAIN = 300
SPLITS = range(5)
WAYS = {
    "least_squares": (Identify(estimator="least_squares"), False),
    "map, huber": (Identify(loss="huber"), False),
    "map": (Identify(), False),
    "map, estimated sigmas": (Identify(), True),
    "map, estimated sigmas, gcv": (Identify(shrinkage="gcv"), True),
}
Row = tuple[
    float, ...
]  # mean and maximum [mm], mean and maximum [deg], the sigmas [mm], [deg], largest change, seconds


def main() -> None:
    if not DATA.is_dir():
        sys.exit(f"skipped: the recordings are not at {DATA}")
    for series, table in SERIES.items():
        splits = list(spread(split, [(series, seed) for seed in SPLITS]))
        rest = splits[0][0]
        print(f"\nseries {series} ({table}): {TRAIN} poses to train, {rest} held out; means over {len(SPLITS)} splits")
        print(
            f"{'':<28}{'mean [mm]':>11}{'of the splits':>19}{'max [mm]':>10}{'mean [deg]':>12}{'max [deg]':>11}"
            f"{'sigma [mm]':>12}{'[deg]':>8}{'moved':>7}{'s a fit':>9}"
        )
        for name in ("nominal", *WAYS):
            found = np.array([rows[name] for _, rows in splits if not isinstance(rows[name], str)])
            if not len(found):
                print(f"{name:<28}none: {splits[0][1][name]}")
                continue
            mm, most_mm, deg, most_deg, sigma_mm, sigma_deg, moved, seconds = found.mean(axis=0)
            spreading = f"{found[:, 0].min():.4f} .. {found[:, 0].max():.4f}"
            failed = f"  {len(splits) - len(found)} failed" if len(found) < len(splits) else ""
            print(
                f"{name:<28}{mm:>11.4f}{spreading:>19}{most_mm:>10.3f}{deg:>12.4f}{most_deg:>11.4f}"
                f"{sigma_mm:>12.3f}{sigma_deg:>8.4f}{moved:>7.1f}{seconds:>9.2f}{failed}",
                flush=True,
            )


def recorded(series: str) -> tuple[ErrorModel, Measurements]:
    """The robot of a series and all its poses, at the sigmas that ur10/robot.toml gives a laser tracker."""
    description = load_robot(str(ROBOTS / "ur10" / "recorded.toml")).description
    chain = model_stage(description.mechanism, Path(description.urdf)).chain()
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    poses = read_table(DATA / SERIES[series], chain.actuated_names, description.measure)
    return errors, to_measurements(poses, chain.actuated_names, load_robot("ur10").description.sensor)


def split(job: tuple[str, int]) -> tuple[int, dict[str, Row | str]]:
    """How many poses are held out, and each method's row on them."""
    series, seed = job
    errors, poses = recorded(series)
    order = np.random.default_rng(seed).permutation(len(poses))
    train, test = poses[np.sort(order[:TRAIN])], poses[np.sort(order[TRAIN:])]
    began = time.perf_counter()
    registered = register(errors, train)
    rows: dict[str, Row | str] = {"nominal": _row(errors, registered.p, test, train, {}, time.perf_counter() - began)}
    for name, (settings, estimated) in WAYS.items():
        began = time.perf_counter()
        measured = replace(train, assumed=train.channels) if estimated else train
        try:
            found = estimate_parameters(errors, measured, settings, registered)
            seconds = time.perf_counter() - began
            rows[name] = _row(errors, found.p, test, train, found.sigma_factors, seconds)
        except CalibrationError as error:
            rows[name] = str(error)
    return len(test), rows


def _row(errors: ErrorModel, p: np.ndarray, test: Measurements, train: Measurements, factors, seconds: float) -> Row:
    robot = errors.robot(p)
    scored = score(test.as_poses(), robot.measured(robot.close(test.readings).pose), test.channels)
    sigmas = train.scaled(factors)
    return (
        scored.mean_mm,
        scored.max_mm,
        scored.mean_deg,
        scored.max_deg,
        1e3 * float(np.mean(sigmas.std["position"])),
        float(np.rad2deg(np.mean(sigmas.std["orientation"]))),
        float(np.max(np.abs(p / errors.parameters.tolerance))),
        seconds,
    )


if __name__ == "__main__":
    main()
