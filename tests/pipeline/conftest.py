"""A small finished run, and ways to call kincal inside this process and outside of it."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.small import QUICK, SMALL
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurements import Measurements
from kincal.learning.correction import Correction, Hull, Spread
from kincal.learning.inherit import inherit
from kincal.learning.units import Inherited, Own, Shared, Units, Waves
from kincal.pipeline.commands.app import main
from kincal.pipeline.learned import Corrected
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod, build
from kincal.pipeline.methods.residual_network import corrected
from kincal.pipeline.results import Comparison, Fit
from kincal.pipeline.run.fingerprint import ROOT
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.store import Store
from kincal.pipeline.virtual.robot import VirtualRobot, draw
from kincal.pipeline.virtual.siblings import residuals, unexplained
from kincal.urdf.description import ROBOTS, Correct, Identify, VirtualErrors, load_robot
from kincal.urdf.kinematics import forward, inverse

ROBOT_COMMANDS = (
    "run",
    "inspect",
    "compare",
    "status",
    "predict",
    "evaluate",
    "compensate",
    "sea-trial",
    "accept",
    "verify",
)


def _complete(arguments) -> list[str]:
    """The command line, with the settings above; its own come last, and win."""
    command, *given = (str(a) for a in arguments)
    if command == "cache":
        return [command, *_complete(given)]
    if command not in ROBOT_COMMANDS or "--help" in given:
        return [command, *given]
    return [command, *(part for setting in SMALL for part in ("--set", setting)), *given]


@dataclass(frozen=True)
class Finished:
    """A finished run of ups3_s with 12 poses."""

    store: Path
    settings: tuple[str, ...]
    comparison: Comparison
    table: pd.DataFrame  # what the virtual robot measured

    def agrees(self, mean_deg: float) -> bool:
        """Whether another process has found the same, but for the order of sums."""
        return mean_deg == pytest.approx(self.comparison.methods[1].mean_deg, rel=1e-9)


@dataclass(frozen=True)
class Answer:
    """What the command said."""

    status: int
    out: str
    err: str


@pytest.fixture(scope="session")
def start():
    """start(store, *overrides) -> (Run, events): a robot's way through the stages, and what it reports."""

    def start(store: Path, *overrides: str, robot: str | Path = "ups3_s", force_from: str | None = None):
        events = []
        return Run(load_robot(str(robot), (*SMALL, *overrides)), Store(store), force_from, events.append), events

    return start


@pytest.fixture(scope="session")
def correction():
    """correction(robot, size): a smooth one of the actuators, of about `size` times their range, not learned.

    shrinkage: its own; hull: of the workspace, how much is taken for measured.
    """

    def correction(loaded, size: float, shrinkage: float = 1.0, hull: float = 1.0) -> Correction:
        readings, gain = loaded.readings(200, seed=9), loaded.model.actuators.gain
        low, high = readings.min(axis=0), readings.max(axis=0)
        k = readings.shape[1]
        groups = Own(4), Waves(np.array([[k - 1, 1.7]])), Shared.random(k, 4, 0)
        units = Units((low + high) / 2, (high - low) / 2, groups)
        readout = 0.3 * np.random.default_rng(0).normal(size=len(units.layout[0]))
        around = Hull.of(units.scaled(readings))
        around = Hull(around.directions, hull * around.reach)
        sure = Spread(np.zeros((len(loaded.model.parameters), 0)), np.zeros((0, 0)), 0.0, 1.0)
        scale = size * np.abs(gain) * (high - low)
        return Correction(units, readout, scale, around, "all", shrinkage, 5.0, {"": 1.0, "all": 0.5}, sure, sure)

    return correction


@dataclass(frozen=True)
class Calibrated:
    """A virtual robot, what it measured, and what was identified and learned from that."""

    loaded: object
    virtual: VirtualRobot
    measured: Measurements
    inherited: Inherited
    fit: Fit
    corrected: Corrected

    @property
    def model(self) -> ErrorModel:
        return self.loaded.model

    @property
    def geometric(self) -> ModelMethod:
        return self._methods["geometric"]

    @property
    def hybrid(self) -> HybridMethod:
        return self._methods["hybrid"]

    @property
    def _methods(self):
        return build(self.model, self.fit, None, self.corrected, self.measured.channels)

    def readings(self, n: int, seed: int, inner: float = 1.0, still: int | None = None) -> np.ndarray:
        return _readings(self.loaded, n, seed, inner, still)

    def correct(self, fit: Fit, spoil: np.ndarray | None = None, wider: float = 1.0) -> Corrected:
        """From another fit; the poses `spoil` are replaced by nonsense; wider: sigmas, that then count as unknown."""
        measured = self.measured.scaled(dict.fromkeys(self.measured.channels, wider))
        if spoil is not None:
            rotation = measured.values["orientation"].copy()
            rotation[spoil] = rotation[spoil][:, ::-1]
            measured = measured.replaced(orientation=rotation)
        return corrected(self.model, measured, fit, self.inherited, Correct(), 0, wider == 1.0)


def _readings(loaded, n: int, seed: int, inner: float, still: int | None) -> np.ndarray:
    """Random in the `inner` part of the workspace; still: the actuator that stays where it is at home."""
    closure = inverse(loaded.chain, inner * loaded.coordinates(n, seed))
    assert closure.closed.all()
    joints = closure.q[:, loaded.chain.actuated]
    if still is not None:
        joints[:, still] = loaded.chain.home[loaded.chain.actuated][still]
        assert forward(loaded.chain, joints).closed.all()
    return loaded.model.actuators.readings(joints)


@pytest.fixture(scope="session")
def calibrated(robot, observed):
    """calibrated(name, n, seed, inner, still, **errors): with n poses of a tracker, each made once a session."""

    @cache
    def inherited(name: str) -> Inherited:
        loaded = robot(name)
        q = loaded.configurations(150, seed=55)
        readings = loaded.model.actuators.readings(q[:, loaded.chain.actuated])
        given = unexplained(loaded.model, readings, q, residuals(loaded.chain, q, 24, 0))
        return inherit(readings, given, hidden=12, iterations=300, seed=0)[0]

    @cache
    def calibrated(name: str, n: int, seed: int, inner: float = 1.0, still: int | None = None, **errors) -> Calibrated:
        loaded = robot(name)
        truth = draw(loaded.model, VirtualErrors(**errors), seed)
        virtual = VirtualRobot.of(loaded.model, truth)
        readings = _readings(loaded, n, 1000 + seed, inner, still)
        moves = any(axis < 3 for axis in loaded.chain.tool_axes)
        std = {"orientation": np.deg2rad(0.0006), "position": 2e-5}
        pose, channels = virtual.pose(readings), ("orientation", "position") if moves else ("orientation",)
        random = np.random.default_rng([seed, 66])
        measured = observed(pose, readings, channels, std, random)
        registered = register(loaded.model, measured, 1000)
        found = estimate_parameters(loaded.model, measured, Identify(), registered)
        fit = Fit(np.zeros(0, dtype=int), registered.p, found.p)
        own = inherited(name)
        return Calibrated(
            loaded, virtual, measured, own, fit, corrected(loaded.model, measured, fit, own, Correct(), seed)
        )

    return calibrated


@pytest.fixture(scope="session")
def finished(start, tmp_path_factory) -> Finished:
    folder = tmp_path_factory.mktemp("finished") / "store"
    run, _ = start(folder, *QUICK)
    compared, measured, _ = run.until("evaluate", "measure", "report")
    return Finished(folder, QUICK, compared, measured.table)


@pytest.fixture
def store(finished, tmp_path) -> Path:
    """A copy of the finished store."""
    return Path(shutil.copytree(finished.store, tmp_path / "store"))


@pytest.fixture
def still_served(finished, start):
    """still_served(store): the finished run's comparison comes from the cache, and nothing runs."""

    def check(store: Path) -> None:
        run, events = start(store, *finished.settings)
        assert run.until("evaluate")[0] == finished.comparison
        assert {e.state for e in events} == {"cached"}

    return check


@pytest.fixture
def robot_folder(tmp_path) -> Path:
    """A copy of ups3_s, to be spoiled."""
    return Path(shutil.copytree(ROBOTS / "ups3_s", tmp_path / "robot"))


@pytest.fixture
def cli(capfd, tmp_path, monkeypatch):
    """cli(*arguments) -> Answer: `kincal` in this process, in tmp_path; an exception that escapes fails the test."""

    def call(*arguments: str | Path) -> Answer:
        monkeypatch.chdir(tmp_path)
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main(_complete(arguments))
        said = capfd.readouterr()
        return Answer(int(left.value.code or 0), said.out, said.err)

    return call


@pytest.fixture(scope="session")
def environment():
    """environment(root): of a process that runs the code below root, whatever is installed."""

    def environment(root: Path = ROOT) -> dict[str, str]:
        plain = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}  # kincal chooses these
        return plain | {"PYTHONPATH": str(root), "PYTHONWARNINGS": "", "PYTHONDONTWRITEBYTECODE": "1"}

    return environment


@pytest.fixture
def kincal(tmp_path, environment):
    """kincal(*arguments) -> Answer: the real command in a process of its own, in tmp_path."""

    def call(*arguments: str | Path, root: Path = ROOT, **options) -> Answer:
        command = [sys.executable, "-m", "kincal", *_complete(arguments)]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment(root), capture_output=True, text=True, timeout=120, **options
        )
        return Answer(done.returncode, done.stdout, done.stderr)

    return call


DIES_ONCE = """
import os, pathlib
from kincal.pipeline.run import fan_out
from kincal.pipeline.run import runner
folder = pathlib.Path({folder!r})
if not (folder / "been").exists():
    (folder / "been").touch()
    def dies(self, stage, *given, _produce=runner.Run._produce, **more):
        return os._exit(1) if stage.name == "measure" else _produce(self, stage, *given, **more)
    runner.Run._produce = dies
job = fan_out.Job("ups3_s", {overrides!r}, folder / "store", "measure")
(folder / "passed").write_text(" ".join(p.state for p in fan_out.carry_out(job).passed))
"""


@pytest.fixture(scope="session")
def dies_once():
    """dies_once(folder): code of a job whose process dies in `measure` once; then `passed` says what ran."""
    return lambda folder: DIES_ONCE.format(folder=str(folder), overrides=QUICK)


@pytest.fixture(scope="session")
def stage_names() -> tuple[str, ...]:
    return tuple(all_stages())


@pytest.fixture(scope="session")
def copy_project():
    """copy_project(folder): the package there, without compiled files and without links."""

    def copy(folder: Path) -> Path:
        shutil.copytree(ROOT / "kincal", folder / "kincal", ignore=shutil.ignore_patterns("__pycache__"))
        return folder

    return copy
