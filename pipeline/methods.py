"""The six methods as one thing: readings to poses in the measurement frame, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from identification.error_model import BuiltRobot, ErrorModel
from learning.network import Network
from learning.residual import Correction
from pipeline.charts import Chart
from pipeline.results import Fit, Learned
from urdf.kinematics import Closure, forward, inverse, tool_coordinates
from urdf.rigid_motion import Motion, wrap

METHODS = ("nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid")  # in the table's order
_ITERATIONS = 30
_REACHED = 1e-9  # of a tool coordinate or a joint [m, rad]


class Method(Protocol):
    def predict(self, readings: np.ndarray) -> Motion:
        """Poses (n) in the measurement frame at readings (n, n_actuated)."""
        ...

    def command(self, desired: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n, n_actuated) that reach desired poses (n) in the measurement frame, and which rows do: (n,)."""
        ...


@dataclass(frozen=True)
class ModelMethod:
    """A model of the robot, with a correction of its actuators where there is one: W * forward(q + delta(q)) * T."""

    robot: BuiltRobot
    correction: Correction | None = None

    def close(self, readings: np.ndarray) -> Closure:
        joints = self.robot.actuators.joints(readings)
        return forward(self.robot.chain, joints + self._delta(readings))

    def predict(self, readings: np.ndarray) -> Motion:
        closure = self.close(readings).require(lambda row: f"row {row + 1}")
        return self.robot.measured(closure.pose)

    def command(self, desired: Motion) -> tuple[np.ndarray, np.ndarray]:
        chain, actuators = self.robot.chain, self.robot.actuators
        u = tool_coordinates(chain, self.robot.instrument.inverse() @ desired @ self.robot.target.inverse())
        found = inverse(chain, u)
        wanted = found.q[:, chain.actuated]
        readings = actuators.readings(wanted)
        for _ in range(_ITERATIONS if self.correction else 0):
            # q + delta(q) = q*: delta is small and smooth, so each step gains three digits
            last, readings = readings, actuators.readings(wanted - self._delta(readings))
            if np.max(np.abs(actuators.gain * (readings - last)), initial=0.0) < 1e-14:
                break
        # There, and not on another assembly branch of the same actuators' values?
        closure, axes = self.close(readings), list(chain.tool_axes)
        left = np.abs(wrap(tool_coordinates(chain, closure.pose) - u)[:, axes]).max(axis=1)
        return readings, found.closed & closure.closed & (left < _REACHED)

    def _delta(self, readings: np.ndarray) -> np.ndarray:
        return 0.0 * readings if self.correction is None else self.correction(readings)


@dataclass(frozen=True)
class NetworkMethod:
    """The paper's networks: readings to the tool's pose in a chart, then through the registered frames."""

    network: Network
    chart: Chart

    def predict(self, readings: np.ndarray) -> Motion:
        return self.chart.pose(self.network(readings), readings)

    def command(self, desired: Motion) -> tuple[np.ndarray, np.ndarray]:
        robot = self.chart.robot
        readings, closed = ModelMethod(robot).command(desired)
        wanted = self.chart.of_tool(robot.instrument.inverse() @ desired @ robot.target.inverse())
        axes = _used(self.chart)
        limit = 0.2 * self.network.input_scale
        for _ in range(_ITERATIONS):  # Newton; of least norm where tilt leaves a freedom
            error = (self.network(readings) - wanted)[:, axes]
            step = (np.linalg.pinv(self.network.jacobian(readings)[:, axes]) @ error[..., None])[..., 0]
            readings = readings - np.clip(step, -limit, limit)
            if np.max(np.abs(step / self.network.input_scale), initial=0.0) < 1e-13:
                break
        left = np.abs((self.network(readings) - wanted)[:, axes]).max(axis=1)
        return readings, closed & (left < _REACHED)


def _used(chart: Chart) -> list[int]:
    """The outputs that the tool can be sent to: its degrees of freedom, where they were measured."""
    if chart.tilt:
        return list(range(chart.n_out))
    names = (["rx", "ry", "rz"] if chart.full else []) + (["x", "y", "z"] if chart.moved else [])
    free = [("x", "y", "z", "rx", "ry", "rz")[a] for a in chart.robot.chain.tool_axes]
    return [k for k, name in enumerate(names) if name in free]


def build(model: ErrorModel, fit: Fit, learned: Learned | None, channels: tuple[str, ...]) -> Mapping[str, Method]:
    """{name: method} of one fit, in the table's order."""
    nominal, identified = model.robot(fit.registered), model.robot(fit.identified)
    found: dict[str, Method] = {"nominal": ModelMethod(nominal), "geometric": ModelMethod(identified)}
    if learned is not None:
        as_drawn, as_built = Chart(nominal, channels), Chart(identified, channels)
        found["network"] = NetworkMethod(learned.network, as_drawn)
        found["transfer"] = NetworkMethod(learned.transfer, as_drawn)
        found["transfer_identified"] = NetworkMethod(learned.transfer_identified, as_built)
        found["hybrid"] = ModelMethod(identified, learned.correction)
    return found


def uncalibrated(model: ErrorModel) -> Method:
    """The nominal robot with W = T = 1."""
    return ModelMethod(model.robot(np.zeros(len(model.parameters))))
