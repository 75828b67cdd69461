"""Commands of a network: Newton's method in its outputs, from the model's command."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kincal.pipeline.compensator.goal import Goal
from kincal.pipeline.compensator.solver import Commanded, ModelSolver
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.methods.predictors import NetworkMethod
from kincal.urdf.kinematics import Closure, actuator_jacobian
from kincal.urdf.rigid_motion import Motion

_ITERATIONS = 30
_REACHED = 1e-9  # of an output [m, rad]
_SETTLED = 1e-11  # of a network's input, of its range


@dataclass(frozen=True)
class NetworkSolver:
    """Steps are of least norm where the outputs leave a freedom."""

    method: NetworkMethod
    model: ModelSolver  # of the chart's robot

    @cached_property
    def goal(self) -> Goal:
        return self.model.goal.seen_by(self.method.chart.channels)

    def commands(self, desired: Motion) -> Commanded:
        """As `Solver` has it."""
        network, chart = self.method.network, self.method.chart
        axes, limit, start = _used(chart), 0.2 * network.input_scale, self.model.commands(desired)
        readings, going = start.readings.copy(), np.flatnonzero(start.reached)
        q, left = self.model.robot.close(readings).q, np.full(len(readings), np.inf)
        for _ in range(_ITERATIONS):
            if not len(going):
                break
            error, slope, closure = self.linearised(desired[going], readings[going], q[going])
            going, error, slope = going[closure.closed], error[closure.closed][:, axes], slope[closure.closed][:, axes]
            q[going] = closure.q[closure.closed]
            step = (np.linalg.pinv(slope) @ error[..., None])[..., 0]
            if len(axes) > readings.shape[1]:  # a hinge can't turn to every tilt: to the nearest
                error = (slope @ step[..., None])[..., 0]
            left[going] = np.abs(error).max(axis=1)
            readings[going] -= np.clip(step, -limit, limit)
            going = going[np.abs(step / network.input_scale).max(axis=1) > _SETTLED]
        return Commanded(readings, left < _REACHED)

    def linearised(
        self, desired: Motion, readings: np.ndarray, q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Closure]:
        """Outputs less those desired (n, n_out), the derivatives (n, n_out, n_actuated), and the model's closure there.

        The desired pose is filled with the prediction, which moves with the readings as far as it is not asked for.
        """
        chart, robot, network, goal = self.method.chart, self.model.robot, self.method.network, self.goal
        y, slope = network(readings), network.jacobian(readings)
        if goal.whole or (chart.tilt and not chart.moved):  # nothing that is filled in shows in the outputs
            n = np.ones(len(q))
            return y - chart.of_tool(goal.tool(desired, desired)), slope, Closure(q, desired, n > 0, 0 * n)
        closure = robot.close(readings, q)
        tool = goal.tool(desired, chart.posed(y, closure.pose.rotation))
        by_actuators = np.linalg.pinv(np.nan_to_num(actuator_jacobian(robot.chain, closure.q)))
        rates = goal.rates(desired, closure.q) @ (by_actuators * robot.actuators.gain)
        if chart.full:
            slope[:, :3] -= rates[:, 3:]
        if chart.moved:
            slope[:, -3:] -= rates[:, :3]
        return y - chart.of_tool(tool), slope, closure


def _used(chart: Chart) -> list[int]:
    """The outputs that the tool can be sent to: its degrees of freedom, where they were measured."""
    names = ["rx", "ry", "rz"] * chart.full + ["tilt", "tilt"] * chart.tilt + ["x", "y", "z"] * chart.moved
    free = [("x", "y", "z", "rx", "ry", "rz")[a] for a in chart.robot.chain.tool_axes]
    turns = any(name.startswith("r") for name in free)
    return [k for k, name in enumerate(names) if name in free or (name == "tilt" and turns)]
