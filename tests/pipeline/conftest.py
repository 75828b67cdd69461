"""A small finished run, and ways to call kincal inside this process and outside of it."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pytest

from pipeline.artifacts import Store
from pipeline.cli import main
from pipeline.fingerprint import ROOT
from pipeline.results import Comparison
from pipeline.runner import Run, all_stages
from urdf.description import ROBOTS, load_robot

# In all tests here, unless they say otherwise: a tracker, and small networks whose accuracy is not looked at.
SMALL = (
    'measure.channels=["orientation"]',
    "prior.poses=125",
    "pretrain.iterations=15",
    "pretrain.continued=3",
    "transfer.iterations=10",
)
QUICK = ("plan.poses=12", *SMALL)
ROBOT_COMMANDS = ("run", "inspect", "compare", "status", "predict", "evaluate", "compensate")


def _complete(arguments) -> list[str]:
    """The command line, with the settings above; its own come last, and win."""
    command, *given = (str(a) for a in arguments)
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
        command = [sys.executable, "-m", "pipeline.cli", *_complete(arguments)]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment(root), capture_output=True, text=True, timeout=120, **options
        )
        return Answer(done.returncode, done.stdout, done.stderr)

    return call


@pytest.fixture(scope="session")
def stage_names() -> tuple[str, ...]:
    return tuple(all_stages())


@pytest.fixture(scope="session")
def copy_project():
    """copy_project(folder): the project's packages there, without compiled files."""

    def copy(folder: Path) -> Path:
        for package in ("urdf", "identification", "learning", "pipeline"):
            shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
        return folder

    return copy
