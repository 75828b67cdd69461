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
from pipeline.goal import WHOLE, Goal
from pipeline.results import Fit, Learned
from urdf.kinematics import Closure, actuator_jacobian, forward, tool_coordinates
from urdf.rigid_motion import Motion, wrap

METHODS = ("nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid")  # in the table's order
_ITERATIONS = 30
_REACHED = 1e-9  # of a tool coordinate or a joint [m, rad]
_SETTLED = 1e-11  # of a network's input, of its range


class Method(Protocol):
    def predict(self, readings: np.ndarray) -> Motion:
        """Poses (n) in the measurement frame at readings (n, n_actuated)."""
        ...

    def command(self, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n, n_actuated) that reach desired poses (n) in the measurement frame, and which rows do: (n,).

        channels: what of the desired poses was measured, and so can be met. A robot with fewer axes than six reaches
        the desired tool pose's coordinates on its tool axes; the others, and what is not in `channels`, are as the
        method predicts them there.
        """
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

    def command(self, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        chain, actuators = self.robot.chain, self.robot.actuators
        found, met = Goal.of(self.robot, desired, channels).solve()
        wanted = found.q[:, chain.actuated]
        readings = actuators.readings(wanted)
        for _ in range(_ITERATIONS if self.correction else 0):
            # q + delta(q) = q*: delta is small and smooth, so each step gains three digits
            last, readings = readings, actuators.readings(wanted - self._delta(readings))
            if np.max(np.abs(actuators.gain * (readings - last)), initial=0.0) < 1e-14:
                break
        # There, and not on another assembly branch of the same actuators' values?
        closure, axes = self.close(readings), list(chain.tool_axes)
        apart = tool_coordinates(chain, closure.pose) - tool_coordinates(chain, found.pose)
        left = np.abs(wrap(apart)[:, axes]).max(axis=1)
        return readings, met & closure.closed & (left < _REACHED)

    def _delta(self, readings: np.ndarray) -> np.ndarray:
        return 0.0 * readings if self.correction is None else self.correction(readings)


@dataclass(frozen=True)
class NetworkMethod:
    """The paper's networks: readings to the tool's pose in a chart, then through the registered frames."""

    network: Network
    chart: Chart

    def predict(self, readings: np.ndarray) -> Motion:
        return self.chart.pose(self.network(readings), readings)

    def command(self, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        """Newton in the outputs, from the model's command; of least norm where the outputs leave a freedom."""
        robot, axes, limit = self.chart.robot, _used(self.chart), 0.2 * self.network.input_scale
        readings, closed = ModelMethod(robot).command(desired, channels)
        goal = Goal.of(robot, desired, channels).seen_by(self.chart.channels)
        q, left, going = robot.close(readings).q, np.full(len(readings), np.inf), np.flatnonzero(closed)
        for _ in range(_ITERATIONS):
            error, slope, there = self._linearised(goal[going], readings[going], q[going])
            going, error, slope = going[there.closed], error[there.closed][:, axes], slope[there.closed][:, axes]
            q[going] = there.q[there.closed]
            inverse = np.linalg.pinv(slope)
            step = (inverse @ error[..., None])[..., 0]
            if len(axes) > readings.shape[1]:  # a hinge can't turn to every tilt: to the nearest
                error = (slope @ step[..., None])[..., 0]
            left[going] = np.abs(error).max(axis=1)
            readings[going] -= np.clip(step, -limit, limit)
            going = going[np.abs(step / self.network.input_scale).max(axis=1) > _SETTLED]
            if not len(going):
                break
        return readings, left < _REACHED

    def _linearised(self, goal: Goal, readings: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, Closure]:
        """Outputs less the goal's (n, n_out), the derivatives (n, n_out, n_actuated), and the model's closure there.

        The goal is filled with the prediction, which moves with the readings as far as it is not asked for.
        """
        chart, robot = self.chart, self.chart.robot
        y, slope = self.network(readings), self.network.jacobian(readings)
        if goal.whole or (chart.tilt and not chart.moved):  # nothing that is filled in shows in the outputs
            n = np.ones(len(q))
            return y - chart.of_tool(goal.tool(goal.desired)), slope, Closure(q, goal.desired, n > 0, 0 * n)
        there = robot.close(readings, q)
        tool = goal.tool(chart.posed(y, there.pose.rotation))
        by_actuators = np.linalg.pinv(np.nan_to_num(actuator_jacobian(robot.chain, there.q)))
        rates = goal.rates(there.q) @ (by_actuators * robot.actuators.gain)
        if chart.full:
            slope[:, :3] -= rates[:, 3:]
        if chart.moved:
            slope[:, -3:] -= rates[:, :3]
        return y - chart.of_tool(tool), slope, there


def _used(chart: Chart) -> list[int]:
    """The outputs that the tool can be sent to: its degrees of freedom, where they were measured."""
    names = ["rx", "ry", "rz"] * chart.full + ["tilt", "tilt"] * chart.tilt + ["x", "y", "z"] * chart.moved
    free = [("x", "y", "z", "rx", "ry", "rz")[a] for a in chart.robot.chain.tool_axes]
    turns = any(name.startswith("r") for name in free)
    return [k for k, name in enumerate(names) if name in free or (name == "tilt" and turns)]


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
