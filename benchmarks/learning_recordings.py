"""Recorded robots: the six methods, and what a peer would learn with scikit-learn, on poses that nothing has seen.

UR10 (Landgraf et al. 2021), series C and D: so many poses train, drawn with the split's seed, and all others are held
out. `C -> D`: trained on C, scored on all of D after W alone was registered there with each row's own predictions.
Jugglebot: five-fold cross-validation of its 108 poses, by `kincal run`.

`network`, `transfer` and `transfer_identified` are trained together: each shows the seconds of all three, pre-training
included. Their source task is drawn in the range of the training readings: the workspace of recorded.toml is elsewhere;
`hybrid` inherits from siblings of that workspace, as in `kincal run`. Ridge, forest and Gaussian process learn the pose
errors of `geometric` on the training poses from the joints' readings. Seconds are of the processor; those of hybrid
and of the peers come on top of those of geometric.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import RidgeCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from benchmarks import ur10_recording
from benchmarks.setup import spread
from kincal.identification.accuracy import orientation_error, score
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurements import Measurements, to_measurements
from kincal.identification.summary import summarise
from kincal.learning.units import Inherited
from kincal.pipeline.learned import Pretrained, SourceTask
from kincal.pipeline.methods.networks import learned, pretrained, source_task
from kincal.pipeline.methods.predictors import METHODS, Method, ModelMethod, build
from kincal.pipeline.methods.refit import refitted
from kincal.pipeline.methods.residual_network import corrected
from kincal.pipeline.results import Fit, Identified
from kincal.pipeline.run.runner import Run
from kincal.pipeline.stages import correction, drawing
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.pipeline.store.store import Store
from kincal.urdf.description import ROBOTS, load_robot
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import Motion, exp

JUGGLEBOT = ur10_recording.DATA.parent / "jugglebot" / "calibration_108.csv"
SERIES = {name.partition(",")[0]: name for name in ur10_recording.SERIES}  # C, D
SIZES = {"C": (100, 300, 1000), "D": (100, 300)}
ACROSS = (300, 1000)  # poses of C to train on for C -> D
CASES = ("C", "D", "C->D", "jugglebot")
PEERS = ("ridge, degree 2", "random forest", "Gaussian process")
ROWS = (*METHODS, *(f"geometric + {peer}" for peer in PEERS))
MOST_GAUSSIAN = 300  # poses: it takes the cube of their number
Row = tuple[float, float, float, float]  # mean and maximum [mm], mean [deg], seconds
Rows = dict[str, Row | str]  # a text: why there is none


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)} (all)")
    parser.add_argument("--splits", type=int, default=5, help="of the UR10's poses (5)")
    parser.add_argument("--poses", type=int, nargs="+", help="to train on, of the UR10's (all)")
    options = parser.parse_args()
    unknown = [case for case in options.cases if case not in CASES]
    if unknown:
        parser.error(f"case {unknown[0]!r} does not exist; allowed: {', '.join(CASES)}")
    cases = options.cases or CASES
    arms = [case for case in cases if case != "jugglebot"]
    if arms and not ur10_recording.DATA.is_dir():
        print(f"skipped {', '.join(arms)}: the recordings are not at {ur10_recording.DATA}")
    elif arms:
        _arms(arms, options.splits, options.poses)
    if "jugglebot" in cases:
        if JUGGLEBOT.is_file():
            rows, n = jugglebot()
            _show(f"jugglebot, five-fold cross-validation of {n} poses", [rows])
        else:
            print(f"skipped jugglebot: the recording is not at {JUGGLEBOT}")


def _arms(cases: list[str], splits: int, sizes: list[int] | None) -> None:
    """Two cases that train on the same poses share the fits."""
    wanted = {("C", n) for n in SIZES["C"] if "C" in cases} | {("C", n) for n in ACROSS if "C->D" in cases}
    wanted |= {("D", n) for n in SIZES["D"] if "D" in cases}
    todo = sorted((series, n) for series, n in wanted if sizes is None or n in sizes)
    kin = _siblings()
    jobs = [(series, n, seed, "C->D" in cases and series == "C", kin) for series, n in todo for seed in range(splits)]
    found = spread(arm, jobs)
    for series, n in todo:
        done = [next(found) for _ in range(splits)]
        if series in cases:
            _show(f"UR10 {series}, {n} poses to train, {done[0][2]} held out; {splits} splits", [d[0] for d in done])
        across = [d[1] for d in done if d[1]]
        if across:
            _show(f"UR10 C -> D, {n} poses of C to train, all of D; {len(across)} splits", across)


def _show(title: str, splits: list[Rows]) -> None:
    print(f"\n{title}\n{'':<30}{'mean [mm]':>11}{'of the splits':>21}{'max [mm]':>10}{'mean [deg]':>12}{'s a fit':>9}")
    for name in (name for name in ROWS if name in splits[0]):
        held = [s[name] for s in splits]
        rows = np.array([row for row in held if not isinstance(row, str)])
        reasons = [row for row in held if isinstance(row, str)]
        if not len(rows):
            print(f"{name:<30}none: {reasons[0]}")
            continue
        mm, most, deg, seconds = rows.mean(axis=0)
        between = f"{rows[:, 0].min():.4f} .. {rows[:, 0].max():.4f}" if len(rows) > 1 else ""
        failed = f"  {len(reasons)} failed: {reasons[0]}" if reasons else ""
        took = f"{seconds:>9.2f}" if np.isfinite(seconds) else f"{'-':>9}"
        print(f"{name:<30}{mm:>11.4f}{between:>21}{most:>10.3f}{deg:>12.4f}{took}{failed}", flush=True)


@dataclass(frozen=True)
class _OneFit(Identified):
    """As much of Identified as one split needs: the fit that has not seen the rows held out."""

    def fits(self) -> tuple[Fit, ...]:
        return (self.held_out,)


class _PredictsAlone:
    def command(self, desired: Motion, channels: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError("predictions alone")


@dataclass(frozen=True)
class _Predicted(_PredictsAlone):
    """A method's predictions at readings that don't change."""

    pose: Motion

    def predict(self, readings: np.ndarray) -> Motion:
        return self.pose[np.arange(len(readings))]


@dataclass(frozen=True)
class _Learned(_PredictsAlone):
    """The geometric prediction plus what a regressor has learned of its errors from the readings (n, n_actuated).

    Errors are those of the position [m], and the rotation vector [rad] in the target's frame.
    """

    geometric: Method
    regressor: Any
    size: np.ndarray  # (6,) of the errors it was trained on

    @staticmethod
    def fitted(name: str, geometric: Method, train: Measurements, seed: int) -> _Learned:
        predicted, actual = geometric.predict(train.readings), train.as_poses()
        turned = orientation_error(predicted.rotation, actual.rotation)
        errors = np.concatenate([actual.translation - predicted.translation, turned], axis=1)
        size = errors.std(axis=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound: a joint without effect
            regressor = _regressor(name, train.readings.shape[1], seed).fit(train.readings, errors / size)
        return _Learned(geometric, regressor, size)

    def predict(self, readings: np.ndarray) -> Motion:
        pose, error = self.geometric.predict(readings), self.regressor.predict(readings) * self.size
        return Motion(pose.rotation @ exp(error[:, 3:]), pose.translation + error[:, :3])


def _regressor(name: str, n_inputs: int, seed: int) -> Any:
    if name == "ridge, degree 2":
        ridge = RidgeCV(alphas=np.logspace(-4, 4, 33), alpha_per_target=True)
        return make_pipeline(StandardScaler(), PolynomialFeatures(2, include_bias=False), StandardScaler(), ridge)
    if name == "random forest":
        return make_pipeline(StandardScaler(), RandomForestRegressor(200, random_state=seed))
    scales: Any = np.full(n_inputs, 2.0)  # of each joint its own
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(scales, (1e-1, 1e3)) + WhiteKernel(0.3)
    one = GaussianProcessRegressor(kernel, normalize_y=True, random_state=seed)
    return make_pipeline(StandardScaler(), MultiOutputRegressor(one))


def arm(job: tuple[str, int, int, bool, Inherited]) -> tuple[Rows, Rows, int]:
    """The rows on the poses of a series that are held out, and after C -> D where that is asked for."""
    series, n, seed, across, kin = job
    errors, poses = _recorded(series)
    order = np.random.default_rng(seed).permutation(len(poses))
    train, test = np.sort(order[:n]), np.sort(order[n:])
    try:
        methods, seconds = _methods(errors, poses, train, test, kin, seed)
    except (CalibrationError, InputError) as error:
        return dict.fromkeys(METHODS, str(error)), {}, len(test)
    rows = _each(methods, lambda name, m: _row(m, poses[test], seconds[name]))
    there: Rows = {}
    if across and n in ACROSS:
        other = _recorded("D")[1]
        kept = {
            k: m for k, m in methods.items() if isinstance(m, str) or k not in METHODS or k in ("geometric", "hybrid")
        }
        there = _each(kept, lambda name, m: _row(_moved(m, other), other, seconds[name]))
    return rows, there, len(test)


def _each(methods: Mapping[str, Method | str], row: Callable[[str, Method], Row]) -> Rows:
    found: Rows = {}
    for name, method in methods.items():
        try:
            found[name] = method if isinstance(method, str) else row(name, method)
        except (CalibrationError, InputError) as error:
            found[name] = str(error)
    return found


def _row(method: Method, test: Measurements, seconds: float) -> Row:
    return _scored(method.predict(test.readings), test.as_poses(), test.channels, seconds)


def _scored(predicted: Motion, actual: Motion, channels: tuple[str, ...], seconds: float) -> Row:
    scored = score(actual, predicted, channels)
    assert scored.mean_mm is not None
    assert scored.max_mm is not None
    assert scored.mean_deg is not None
    return scored.mean_mm, scored.max_mm, scored.mean_deg, seconds


def _moved(method: Method, measured: Measurements) -> Method:
    return refitted(_Predicted(method.predict(measured.readings)), measured, register=True, rehome=False)


@lru_cache
def _recorded(series: str) -> tuple[ErrorModel, Measurements]:
    """The robot of a series and its poses, whose sigmas nobody gave: as recorded.toml has it, and `kincal run`."""
    errors, poses = ur10_recording.recorded(SERIES[series])
    return errors, replace(poses, assumed=poses.channels)


def _methods(
    errors: ErrorModel, poses: Measurements, train: np.ndarray, test: np.ndarray, kin: Inherited, seed: int
) -> tuple[dict[str, Method | str], dict[str, float]]:
    """{row: method, or why there is none}, fitted on the rows `train`, and the seconds they took."""
    description = load_robot(str(ROBOTS / "ur10" / "recorded.toml")).description
    seconds: dict[str, float] = {}
    with _timed(seconds, "nominal"):
        registered = register(errors, poses[train])
    with _timed(seconds, "geometric"):
        found = estimate_parameters(errors, poses[train], description.identify, registered)
    fit = Fit(test, registered.p, found.p)
    shipped = summarise(errors, poses[train], found, registered, description.identify)
    scaled = poses.scaled(shipped.sensor_estimated)
    identified = _OneFit(shipped, registered.p, fit, ())
    with _timed(seconds, "networks"):
        task, prior = _prior(errors, poses[train].readings, identified, seed)
        nets = learned(errors, poses, identified, task, prior, description.pretrain, description.transfer, seed)[0]
    seconds |= dict.fromkeys(("network", "transfer", "transfer_identified"), seconds["networks"])
    with _timed(seconds, "hybrid"):
        known = not shipped.sensor_estimated
        own = corrected(errors, scaled, fit, kin, description.correct, seed, known)
    methods: dict[str, Method | str] = dict(build(errors, fit, nets, own, poses.channels))
    geometric = methods["geometric"]
    assert not isinstance(geometric, str)
    peers, took = _peers(geometric, poses[train], seed)
    return methods | peers, seconds | took


def _prior(
    errors: ErrorModel, readings: np.ndarray, identified: Identified, seed: int
) -> tuple[SourceTask, Pretrained]:
    settings = load_robot(str(ROBOTS / "ur10" / "recorded.toml")).description
    random = np.random.default_rng([seed, 41])
    there = random.uniform(readings.min(axis=0), readings.max(axis=0), (settings.prior.poses, readings.shape[1]))
    task = source_task(errors, there, identified, settings.pretrain)
    return task, pretrained(task, settings.pretrain, seed)


def _siblings() -> Inherited:
    """Of the arm in the workspace of recorded.toml."""
    description = load_robot(str(ROBOTS / "ur10" / "recorded.toml")).description
    drawn = drawing.model_stage(description.mechanism, Path(description.urdf))
    return correction.siblings_stage(DrawnRobot.of(drawn, description), description.siblings).inherited


def _peers(geometric: Method, train: Measurements, seed: int) -> tuple[dict[str, Method | str], dict[str, float]]:
    found: dict[str, Method | str] = {}
    seconds: dict[str, float] = {}
    for peer in PEERS:
        name = f"geometric + {peer}"
        if peer == "Gaussian process" and len(train) > MOST_GAUSSIAN:
            found[name] = f"{len(train)} poses take too long; up to {MOST_GAUSSIAN}"
            continue
        with _timed(seconds, name):
            found[name] = _Learned.fitted(peer, geometric, train, seed)
    return found, seconds


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.process_time()
    yield
    seconds[name] = time.process_time() - began


def jugglebot() -> tuple[Rows, int]:
    """The rows of `kincal run jugglebot --set measure.table=calibration_108.csv`, and the peers on its folds."""
    with tempfile.TemporaryDirectory() as folder:
        session = Run(load_robot("jugglebot", [f"measure.table={JUGGLEBOT}"]), Store(Path(folder)))
        model, filtered, identified, compared = session.until("model", "filter", "identify", "evaluate")
    description = session.robot.description
    chain = model.chain()
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    poses = to_measurements(filtered.table, chain.actuated_names, description.sensor)
    rows: Rows = {m.name: (m.mean_mm, m.max_mm, m.mean_deg, np.nan) for m in compared.methods}
    folds = [_fold(errors, poses, fit) for fit in identified.folds]
    actual = poses.as_poses()[np.concatenate([fit.test for fit in identified.folds])]
    for name in folds[0][0]:
        parts = [predicted[name] for predicted, _ in folds]
        whole = Motion(np.concatenate([m.rotation for m in parts]), np.concatenate([m.translation for m in parts]))
        seconds = float(np.mean([took[name] for _, took in folds]))
        rows[name] = _scored(whole, actual, poses.channels, seconds)
    return rows, len(poses)


def _fold(errors: ErrorModel, poses: Measurements, fit: Fit) -> tuple[dict[str, Motion], dict[str, float]]:
    """The peers' predictions of the poses that the fit has not seen, and the seconds of their training."""
    train = poses[np.setdiff1d(np.arange(len(poses)), fit.test)]
    peers, seconds = _peers(ModelMethod(errors.robot(fit.identified)), train, seed=0)
    readings = poses[fit.test].readings
    return {name: peer.predict(readings) for name, peer in peers.items() if not isinstance(peer, str)}, seconds


if __name__ == "__main__":
    main()
