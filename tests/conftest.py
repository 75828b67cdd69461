"""What the tests share: robots loaded as closed chains, virtual measurements without hidden parts, the shared data."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: BLAS threads only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import signal
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.pipeline.compensator.goal import WHOLE
from kincal.pipeline.compensator.solvers import Solvers
from kincal.urdf.closed_chain import ClosedChain, load_chain
from kincal.urdf.description import ROBOTS, RobotDescription, load_robot
from kincal.urdf.kinematics import at_home, inverse
from kincal.urdf.rigid_motion import Motion, exp, from_xyz_angles
from kincal.urdf.workspace import WorkspaceReport, check_workspace, sample

DATA = Path(__file__).parent / "data"

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job; Ctrl-C is tested here
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("kincal", deadline=None, derandomize=True, max_examples=20, print_blob=False)
settings.load_profile("kincal")


@dataclass(frozen=True)
class LoadedRobot:
    """A robot with its home solved, and its nominal error model."""

    description: RobotDescription
    chain: ClosedChain
    model: ErrorModel

    def coordinates(self, n: int, seed: int) -> np.ndarray:
        """Tool coordinates (n, 6), random in the workspace."""
        return sample(self.description.workspace, self.chain.tool_axes, n, seed)

    def configurations(self, n: int, seed: int) -> np.ndarray:
        """Closed configurations (n, n_joints), random in the workspace."""
        closure = inverse(self.chain, self.coordinates(n, seed))
        assert closure.closed.all()
        return closure.q

    def readings(self, n: int, seed: int) -> np.ndarray:
        """Actuator readings (n, n_actuated), random in the workspace."""
        return self.model.actuators.readings(self.configurations(n, seed)[:, self.chain.actuated])

    def random_parameters(self, seed: int, tolerances: float = 1.0, instrument=None, target=None) -> np.ndarray:
        """p of a robot drawn from `tolerances` times its tolerance; W and T as given, else 1 degree and 10 mm off."""
        random = np.random.default_rng([seed, 77])
        flat = self.model.parameters.flat
        p = tolerances * random.normal(size=len(flat)) * np.where(flat, 0.0, self.model.parameters.tolerance)
        p[-12:] = random.normal(size=12) * np.tile(np.repeat([0.01, np.deg2rad(1.0)], 3), 2)
        if instrument is not None:
            p[-12:-6] = instrument.vector()
        if target is not None:
            p[-6:] = target.vector()
        return p

    def command(self, method, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n, n_actuated) by which `method` reaches desired poses (n), and which it reaches: (n,)."""
        commanded = Solvers(self.description.workspace).of(method, channels).commands(desired)
        return commanded.readings, commanded.reached

    def poses(self, p: np.ndarray, readings: np.ndarray) -> Motion:
        """Measured-like poses (n) of the robot with parameters p, its loops closed."""
        robot = self.model.robot(p)
        closure = robot.close(readings)
        assert closure.closed.all()
        return robot.measured(closure.pose)

    def measure(
        self, p: np.ndarray, readings: np.ndarray, channels: tuple[str, ...], std: dict | None = None, noise=None
    ) -> Measurements:
        """What a robot with parameters p measures of `channels`; std: one sigma a channel (default 1e-4).

        noise: a random generator, or None for readings without noise.
        """
        return observe(self.poses(p, readings), readings, channels, std, noise)


def observe(pose: Motion, readings: np.ndarray, channels, std=None, noise=None) -> Measurements:
    """Poses (n) as the instruments of `channels` see them; tilt and yaw are those of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    n, r = len(readings), pose.rotation
    sigma = dict.fromkeys(channels, 1e-4) | (std or {})
    scale = {c: 0.0 if noise is None else sigma[c] for c in channels}

    def error(channel: str, *shape: int) -> np.ndarray:
        return scale[channel] * noise.normal(size=(n, *shape)) if noise is not None else np.zeros((n, *shape))

    values, std = {}, {channel: np.full(n, sigma[channel]) for channel in channels}
    for channel in channels:
        if channel == "orientation":
            values[channel] = r @ exp(error(channel, 3))
        elif channel == "position":
            values[channel] = pose.translation + error(channel, 3)
        elif channel == "tilt":
            angles = np.stack([np.arctan2(r[:, 2, 1], r[:, 2, 2]), -np.arcsin(r[:, 2, 0])], axis=1)
            values[channel] = angles + error(channel, 2)
        else:
            values[channel] = np.arctan2(r[:, 1, 0], r[:, 0, 0]) + error(channel)
    return Measurements(np.arange(n), readings, values, std)


def load(robot: str, overrides: tuple[str, ...] = ()) -> LoadedRobot:
    """A robot of tests/data, a shipped one, or one by path."""
    own = DATA / robot
    found = load_robot(str(own if own.is_dir() else robot), overrides)
    description = found.description
    chain = load_chain(description.mechanism, description.urdf.read_text(), description.urdf)
    workspace, home = description.workspace, None
    if workspace.home_mm is not None:
        angles = np.deg2rad(workspace.home_rotation_deg or (0.0, 0.0, 0.0))
        home = Motion(from_xyz_angles(angles), np.array(workspace.home_mm) * 1e-3)
    chain = at_home(chain, home)
    return LoadedRobot(description, chain, ErrorModel.of(chain, description.actuator, description.tolerance))


_load_once = lru_cache(maxsize=None)(load)


@pytest.fixture(scope="session")
def robot() -> Callable[..., LoadedRobot]:
    """robot(name): loaded once a session."""
    return _load_once


@pytest.fixture(scope="session")
def checked() -> Callable[..., WorkspaceReport]:
    """checked(path, overrides): a robot loaded afresh, its workspace checked."""

    def check(robot, overrides: tuple[str, ...] = ()) -> WorkspaceReport:
        loaded = load(str(robot), overrides)
        return check_workspace(loaded.chain, loaded.description.workspace)

    return check


@pytest.fixture
def edited(tmp_path) -> Callable[..., Path]:
    """edited(urdf=[(old, new), ..], toml=[..], robot="ups3_s"): the path to a copy of a robot with text replaced."""

    def edit(urdf=(), toml=(), robot: str = "ups3_s") -> Path:
        source = ROBOTS / robot
        for name, changes in (("robot.urdf", urdf), ("robot.toml", toml)):
            text = (source / name).read_text()
            for old, new in changes:
                assert old in text, f"{name} has no {old!r}"
                text = text.replace(old, new, 1)
            (tmp_path / name).write_text(text)
        return tmp_path / "robot.toml"

    return edit


@pytest.fixture(scope="session")
def observed() -> Callable[..., Measurements]:
    """observed(poses, readings, channels): measurements of given poses."""
    return observe


@pytest.fixture(scope="session")
def central_difference() -> Callable[..., np.ndarray]:
    """central_difference(f, x, step): d f / d x along a new last axis, x: (k,); error of order step^4.

    f takes a batch (m, k) and returns (m, ...): all steps are one call.
    """

    def difference(f, x: np.ndarray, step: float = 2e-4) -> np.ndarray:
        steps = step * np.concatenate([k * np.eye(len(x)) for k in (1, -1, 2, -2)])
        one, minus_one, two, minus_two = np.split(np.asarray(f(x + steps)), 4)
        return np.moveaxis((8 * (one - minus_one) - (two - minus_two)) / (12 * step), 0, -1)

    return difference


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded data sets beside the project."""
    found = (Path(__file__).parents[2] / "shared" / "data").resolve()
    if not found.is_dir():
        pytest.skip(f"recorded data sets are not at {found}")
    return found
