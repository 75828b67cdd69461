"""A robot with known errors that measures itself.

Geometric errors are drawn from the tolerances, on every placement and actuator; W and T are off by a degree. Legs give
under a payload, actuators have screw (or gear) errors; both shift the actuated joints, the loops stay closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from identification.error_model import BuiltRobot, ErrorModel
from identification.measurements import default_channels as default_channels
from identification.measurements import quaternions
from pipeline.results import Truth
from urdf.description import Sensor, Stream, VirtualErrors
from urdf.kinematics import Closure, forward, passive_rates, tool_point_jacobian
from urdf.rigid_motion import Motion, exp

GRAVITY = 9.80665  # m/s^2
_SETTLING = 3  # iterations of load and deflection; each gains some four digits


def draw(model: ErrorModel, errors: VirtualErrors, seed: int) -> Truth:
    """A robot at random."""
    random = np.random.default_rng([seed, 1])
    parameters = model.parameters
    p = random.normal(size=len(parameters)) * np.where(parameters.flat, 0.0, parameters.tolerance)
    if not errors.geometric:
        p[:] = 0.0
    for frame in (p[-12:-6], p[-6:]):
        for part, size in (
            (slice(0, 3), errors.frame_translation_mm * 1e-3),
            (slice(3, 6), np.deg2rad(errors.frame_rotation_deg)),
        ):
            direction = random.normal(size=3)
            frame[part] = size * direction / np.linalg.norm(direction)
    return Truth(p, random.uniform(0, 2 * np.pi, len(model.actuators.gain)), errors)


@dataclass(frozen=True)
class VirtualRobot:
    """The robot as built, its non-geometric errors included."""

    robot: BuiltRobot
    truth: Truth
    home: np.ndarray  # (n_actuated,) nominal joint values at home

    @staticmethod
    def of(model: ErrorModel, truth: Truth) -> VirtualRobot:
        return VirtualRobot(model.robot(truth.p), truth, model.chain.home[model.chain.actuated])

    def close(self, readings: np.ndarray) -> Closure:
        """The true configurations at the actuators' readings (n, n_actuated), and whether the robot can be there."""
        chain, errors = self.robot.chain, self.truth.errors
        commanded = self.robot.actuators.joints(readings)
        if errors.screw:
            commanded = commanded + self._screw(commanded)
        closure = forward(chain, commanded)
        rows = np.flatnonzero(closure.closed)
        if errors.elastic and len(rows):
            for _ in range(_SETTLING):
                loaded = forward(chain, commanded[rows] + self._deflection(closure.q[rows]), closure.q[rows])
                closure = closure.replaced(rows, loaded)
        return closure

    def pose(self, readings: np.ndarray) -> Motion:
        """The true poses (n) in the measurement frame at the actuators' readings (n, n_actuated)."""
        closure = self.close(readings).require(lambda row: f"virtual robot: readings of row {row}")
        return self.robot.measured(closure.pose)

    def _screw(self, joints: np.ndarray) -> np.ndarray:
        """A periodic and a quadratic error of each actuator [m or rad]."""
        errors, sliding = self.truth.errors, self.robot.chain.prismatic[self.robot.chain.actuated]
        amplitude = np.where(sliding, errors.screw_amplitude_mm * 1e-3, np.deg2rad(errors.gear_amplitude_deg))
        period = np.where(sliding, errors.screw_period_mm * 1e-3, np.deg2rad(errors.gear_period_deg))
        quadratic = np.where(sliding, errors.screw_quadratic_per_m, errors.gear_quadratic_per_rad)
        return (
            amplitude * np.sin(2 * np.pi * joints / period + self.truth.phase) + quadratic * (joints - self.home) ** 2
        )

    def _deflection(self, q: np.ndarray) -> np.ndarray:
        """How far each actuator gives under the payload's weight, by virtual work: -m g (dz / dq) / stiffness."""
        chain, errors = self.robot.chain, self.truth.errors
        up = chain.base.rotation @ self.robot.instrument.rotation.T[:, 2]  # vertical is the instrument's z
        centre = np.array(errors.payload_centre_mm) * 1e-3
        height = np.einsum("i,nij,njk->nk", up, tool_point_jacobian(chain, q, centre), passive_rates(chain, q))
        sliding = chain.prismatic[chain.actuated]
        stiffness = np.where(sliding, errors.stiffness_n_per_m, errors.stiffness_nm_per_rad)
        return -errors.payload_kg * GRAVITY * height / stiffness


def stream_of(pose: Motion, channels: tuple[str, ...], sensor: Sensor, stream: Stream, seed: int) -> pd.DataFrame:
    """Raw samples of an inclinometer (and a heading reference) on true poses (n): noise, outliers, dropouts."""
    random = np.random.default_rng([seed, 10])
    n, per_pose = len(pose.translation), max(1, round(stream.rate_hz * stream.seconds))
    count = n * per_pose
    r = np.repeat(pose.rotation, per_pose, axis=0)
    true = {"roll": np.arctan2(r[:, 2, 1], r[:, 2, 2]), "pitch": -np.arcsin(r[:, 2, 0])}
    if "yaw" in channels:
        true["yaw"] = np.arctan2(r[:, 1, 0], r[:, 0, 0])
    columns = {"t": np.arange(count) / stream.rate_hz, "pose": np.repeat(np.arange(n), per_pose)}
    outlier = {"tilt": random.random(count) < stream.outliers, "yaw": random.random(count) < stream.outliers}
    for name, values in true.items():
        kind = "yaw" if name == "yaw" else "tilt"
        noise = sensor.sigma("yaw" if kind == "yaw" else "tilt") * random.normal(size=count)
        wrong = np.deg2rad(stream.outlier_deg) * random.choice([-1.0, 1.0], count)
        columns[name] = values + noise + np.where(outlier[kind], wrong, 0.0)
    came = random.random(count) >= stream.dropouts
    return pd.DataFrame({name: values[came] for name, values in columns.items()})


def measure(pose: Motion, channels: tuple[str, ...], sensor: Sensor, seed: int) -> dict[str, np.ndarray]:
    """Columns of a measurement table: true poses (n) with each sensor's noise."""
    random = np.random.default_rng([seed, 2])
    n = len(pose.translation)
    columns: dict[str, np.ndarray] = {}
    if "orientation" in channels:
        noise = sensor.sigma("orientation") * random.normal(size=(n, 3))
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternions(pose.rotation @ exp(noise)).T, strict=True))
    if "position" in channels:
        noise = sensor.sigma("position") * random.normal(size=(n, 3))
        columns |= dict(zip("xyz", (pose.translation + noise).T, strict=True))
    r = pose.rotation
    if "tilt" in channels:
        noise = sensor.sigma("tilt") * random.normal(size=(n, 2))
        columns["roll"] = np.arctan2(r[:, 2, 1], r[:, 2, 2]) + noise[:, 0]
        columns["pitch"] = -np.arcsin(r[:, 2, 0]) + noise[:, 1]
    if "yaw" in channels:
        columns["yaw"] = np.arctan2(r[:, 1, 0], r[:, 0, 0]) + sensor.sigma("yaw") * random.normal(size=n)
    return columns
