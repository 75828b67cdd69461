"""Do the 95 % regions of `kincal predict` hold the truth 95 times in 100? Virtual robots that nothing was tuned on.

Each robot is measured at its planned poses; then where it really is at 200 fresh poses, without noise, is compared with
what `geometric` and `hybrid` predict there. `ellipsoid`: by the Mahalanobis distance of the predicted covariance;
`ball`: within the told radius. Shares are pooled over robots, with the least and the most of a single robot; p / t:
predicted over true root mean square error, mean over robots; on: robots on which the correction is believed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.setup import Bench, bench, spread
from kincal.identification.accuracy import orientation_error
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.expected import of_one_row
from kincal.identification.measurements import Measurements, to_measurements, to_table
from kincal.identification.poses import planned
from kincal.learning.units import Inherited
from kincal.pipeline.methods.covariance import pose_covariance, radius
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod, build
from kincal.pipeline.methods.residual_network import corrected
from kincal.pipeline.results import Fit
from kincal.pipeline.stages import correction, drawing
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.pipeline.virtual.robot import VirtualRobot, draw, measure
from kincal.urdf.description import Channel, Identify, Plan, Sensor, VirtualErrors, load_robot
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import inverse

FRESH, HELD = 200, 0.95
FIRST = 1000  # seed of the first robot
ERRORS = {"geometric errors": VirtualErrors(elastic=False, screw=False), "all errors": VirtualErrors()}
METHODS = ("geometric", "hybrid")
PARTS = {"orientation": slice(0, 3), "position": slice(3, 6)}  # rows of the covariance


@dataclass(frozen=True)
class Case:
    robot: str
    channels: tuple[Channel, ...]
    poses: tuple[int, ...]

    @property
    def told(self) -> str:
        return f"{self.robot}, {' and '.join(self.channels)}"

    @property
    def parts(self) -> tuple[str, ...]:
        return ("orientation", "position") if "position" in self.channels else ("orientation",)


CASES = (
    Case("ups3_s", ("orientation",), (20, 50, 150)),
    Case("ups3_s", ("tilt", "yaw"), (20, 50, 150)),  # a row is the mean of a pose's samples
    Case("gough_stewart", ("orientation", "position"), (50,)),
)
Row = tuple[float, float, float, float]  # shares within ellipsoid and ball, p / t, 1.0 where the correction is believed
Job = tuple[Case, str, int, int, Inherited]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help=f"words of {'; '.join(case.told for case in CASES)} (all)")
    parser.add_argument("--robots", type=int, default=20, help="virtual robots a row (20)")
    options = parser.parse_args()
    rows = [
        (case, errors, n)
        for case in CASES
        if not options.cases or any(word in case.told for word in options.cases)
        for errors in ERRORS
        for n in case.poses
    ]
    seeds = range(FIRST, FIRST + options.robots)
    kin = {name: _siblings(name) for name in dict.fromkeys(case.robot for case, *_ in rows)}
    found = spread(one, [(*row, seed, kin[row[0].robot]) for row in rows for seed in seeds])
    before = None
    for case, errors, n in rows:
        if (case, errors) != before:
            print(f"\n{case.told}; {errors}; {options.robots} robots, seeds {seeds[0]} .. {seeds[-1]}")
            print(f"{'n':>5}  {'':<10}{'':<12}{'ellipsoid':>25}{'ball':>25}{'p / t':>8}{'on':>5}")
        before = case, errors
        done = [next(found) for _ in seeds]
        held = [f for f in done if not isinstance(f, str)]
        for method in METHODS:
            for part in case.parts:
                _show(n, method, part, np.array([f[method, part] for f in held]))
        for seed, failure in zip(seeds, done, strict=True):
            if isinstance(failure, str):
                print(f"    robot {seed}: {failure}", flush=True)


def _show(n: int, method: str, part: str, rows: np.ndarray) -> None:
    if not len(rows):
        return
    cells = [f"{100 * s.mean():6.1f} % ({100 * s.min():.1f} .. {100 * s.max():.1f})" for s in rows[:, :2].T]
    on = f"{int(rows[:, 3].sum()):>5}" if method == "hybrid" else ""
    print(f"{n:>5}  {method:<10}{part:<12}{cells[0]:>25}{cells[1]:>25}{rows[:, 2].mean():>8.2f}{on}", flush=True)


def one(job: Job) -> dict[tuple[str, str], Row] | str:
    """Of virtual robot `seed`: each method's row for each part of a pose; or why there is none."""
    case, errors, n, seed, kin = job
    at = bench(case.robot, case.channels)
    truth = draw(at.model, ERRORS[errors], seed)
    robot = VirtualRobot.of(at.model, truth)
    try:
        measured = _measured(at, case, robot, n, seed)
        registered = register(at.model, measured)
        found = estimate_parameters(at.model, measured, Identify(), registered)
        fit = Fit(np.zeros(0, dtype=np.int64), registered.p, found.p)
        own = corrected(at.model, measured, fit, kin, load_robot(case.robot).description.correct, seed)
        readings = at.sites(FRESH, [seed, 61]).readings
        actual = robot.pose(readings)
    except (CalibrationError, InputError) as error:
        return f"{type(error).__name__}: {error}"
    methods, rows = build(at.model, fit, None, own, measured.channels), {}
    for name in METHODS:
        method = methods[name]
        assert isinstance(method, ModelMethod | HybridMethod)
        predicted = method.predict(readings)
        covariance = pose_covariance(at.model, fit, own, method, readings)
        turned = orientation_error(actual.rotation, predicted.rotation)
        error = np.concatenate([turned, predicted.translation - actual.translation], axis=1)
        for part in case.parts:
            k = PARTS[part]
            rows[name, part] = (*_held(error[:, k], covariance[:, k, k]), float(own.correction.shrinkage > 0))
    return rows


def _held(error: np.ndarray, covariance: np.ndarray) -> tuple[float, float, float]:
    """Of errors (n, 3) with covariances (n, 3, 3): shares within ellipsoid and ball, and predicted over true size."""
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    distance = np.linalg.norm(error, axis=1)
    size = np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)) / np.mean(distance**2))
    return (
        float(np.mean(square < chi2.ppf(HELD, error.shape[1]))),
        float(np.mean(distance < radius(covariance, HELD))),
        float(size),
    )


def _measured(at: Bench, case: Case, robot: VirtualRobot, n: int, seed: int) -> Measurements:
    chain, sensor = at.model.chain, _sensor(case)
    u = planned(at.workspace, chain.tool_axes, Plan(poses=n), seed)
    readings = at.model.actuators.readings(inverse(chain, u).q[:, chain.actuated])
    columns = measure(robot.pose(readings), at.channels, sensor, seed)
    return to_measurements(to_table(chain.actuated_names, readings, columns), chain.actuated_names, sensor)


def _sensor(case: Case) -> Sensor:
    """With the sigmas of a table's row."""
    instruments = load_robot(case.robot).description.planned_instruments
    return of_one_row(instruments.model_copy(update={"channels": case.channels}), ())[1]


def _siblings(robot: str) -> Inherited:
    given = load_robot(robot).description
    drawn = drawing.model_stage(given.mechanism, Path(given.urdf))
    return correction.siblings_stage(DrawnRobot.of(drawn, given), given.siblings).inherited


if __name__ == "__main__":
    main()
