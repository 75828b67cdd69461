"""A virtual robot that moves between still poses on a known schedule, and the sensor that logs it; NMEA by hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kincal.identification.streams.static_poses import StaticPoses, static_poses
from kincal.urdf.description import Log, Measure

JOINTS = ("a", "b", "c")
PLANE = np.array([[100.0, 30.0, -50.0], [20.0, -80.0, 60.0]])  # roll, pitch [deg] by joint values


def angles_of(joints: np.ndarray) -> np.ndarray:
    """Roll, pitch (n, 2) [rad] of joint values (n, 3): a plane, bent."""
    return np.deg2rad(joints @ PLANE.T + 200 * joints[:, :2] * joints[:, 1:])


@dataclass(frozen=True)
class Schedule:
    """A campaign as it was. Times on the command log's clock [s]."""

    joints: np.ndarray  # (n, 3)
    commanded: np.ndarray  # (n,) when each target was sent
    arrived: np.ndarray  # (n,)
    offset: float  # the sensor's clock minus the command log's
    log: pd.DataFrame

    @property
    def commands(self) -> pd.DataFrame:
        return pd.DataFrame({"t": self.commanded, **dict(zip(JOINTS, self.joints.T, strict=True))})


def campaign(
    joints: np.ndarray, dwell=(6.0, 10.0), rate=50.0, noise_deg=0.01, offset=1234.5, seed=0, gyro=False
) -> Schedule:
    """Smooth moves of 1 to 2.5 s between `joints`, each held for a drawn time after it was reached."""
    random = np.random.default_rng(seed)
    n = len(joints)
    travel, held = random.uniform(1.0, 2.5, n), random.uniform(*dwell, n)
    commanded = 100.0 + np.concatenate([[0.0], np.cumsum(travel + held)[:-1]])
    t = np.arange(97.0, commanded[-1] + travel[-1] + held[-1], 1 / rate)
    k = np.maximum(np.searchsorted(commanded, t, side="right") - 1, 0)
    way = np.clip((t - commanded[k]) / travel[k], 0, 1)
    before = np.vstack([joints[:1], joints[:-1]])
    there = before[k] + (joints[k] - before[k]) * (way * way * (3 - 2 * way))[:, None]
    read = angles_of(there) + np.deg2rad(noise_deg) * random.normal(size=(len(t), 2))
    log = pd.DataFrame({"t": t + offset, "roll": read[:, 0], "pitch": read[:, 1]})
    if gyro:  # it turns about the vertical as well, by the third joint
        rates = np.gradient(there[:, 2], t) + 1e-4 * random.normal(size=len(t)) + 3e-3
        log = log.assign(gyro_x=0.0, gyro_y=0.0, gyro_z=rates)
    return Schedule(joints, commanded, commanded + travel, offset, log)


def found_in(schedule: Schedule, folder: Path, log: Log | None = None) -> StaticPoses:
    """What kincal makes of the schedule's two files."""
    schedule.log.to_csv(folder / "log.csv", index=False)
    schedule.commands.to_csv(folder / "commands.csv", index=False)
    measure = Measure(streams=folder / "log.csv", commands=folder / "commands.csv", log=log or Log())
    return static_poses(measure, JOINTS)


def sentence(body: str) -> str:
    """With its checksum: the exclusive or of all between $ and *."""
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"


@pytest.fixture(scope="session")
def campaigns():
    """campaigns(joints, ..) -> Schedule."""
    return campaign


@pytest.fixture
def found(tmp_path):
    """found(schedule, log=None) -> StaticPoses."""
    return lambda schedule, log=None: found_in(schedule, tmp_path, log)


@pytest.fixture(scope="session")
def nmea():
    """nmea(body) -> the sentence, its checksum by hand."""
    return sentence


@pytest.fixture
def write(tmp_path):
    """write(name, lines) -> the file."""

    def write(name: str, lines: list[str]) -> Path:
        (tmp_path / name).write_text("\r\n".join(lines) + "\r\n")
        return tmp_path / name

    return write
