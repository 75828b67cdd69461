"""The six methods as one thing: readings to poses in the measurement frame, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.learning.correction import Correction
from kincal.learning.network import Network
from kincal.pipeline.learned import Corrected, Learned
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.methods.goal import WHOLE, Goal
from kincal.pipeline.results import Fit
from kincal.urdf.kinematics import Closure, actuator_jacobian, tool_coordinates
from kincal.urdf.rigid_motion import Motion, exp, log, wrap

METHODS = ("nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid")  # in the table's order
_ITERATIONS = 30
_REACHED = 1e-9  # of a tool coordinate or a joint [m, rad]
_SETTLED = 1e-11  # of a network's input, of its range
_STILL = 1e-12  # of an actuator [m, rad], between two steps


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
    """A model of the robot: W * forward(q) * T."""

    robot: BuiltRobot
    name: str = "geometric"

    def close(self, readings: np.ndarray) -> Closure:
        return self.robot.close(readings)

    def predict(self, readings: np.ndarray) -> Motion:
        closure = self.close(readings).require(lambda row: f"row {row + 1}")
        return self.robot.measured(closure.pose)

    def command(self, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        closure, met = Goal.of(self.robot, desired, channels).solve()
        readings = self.readings(closure)
        return readings, met & self.on_branch(readings, closure)

    def readings(self, closure: Closure) -> np.ndarray:
        return self.robot.actuators.readings(closure.q[:, self.robot.chain.actuated])

    def on_branch(self, readings: np.ndarray, solution: Closure) -> np.ndarray:
        """(n,): whether the readings lead from home to the configurations, and not to another assembly branch."""
        chain, closure = self.robot.chain, self.close(readings)
        apart = tool_coordinates(chain, closure.pose) - tool_coordinates(chain, solution.pose)
        left = np.abs(wrap(apart)[:, list(chain.tool_axes)]).max(axis=1)
        return closure.closed & (left < _REACHED)


@dataclass(frozen=True)
class HybridMethod:
    """From the identified model towards the refined one with the actuators' correction, W * forward(q + delta(q)) * T.

    All the way where the correction is believed; not at all, to the last bit, where it is not.
    """

    geometric: ModelMethod
    refined: BuiltRobot
    correction: Correction

    def close(self, readings: np.ndarray, start: np.ndarray | None = None) -> Closure:
        """The refined model's configurations, with the correction; start: (n, n_joints) near by, where known."""
        return self.refined.close(readings, start, shift=self.correction(readings))

    def predict(self, readings: np.ndarray) -> Motion:
        return self._predicted(readings, self.geometric.predict(readings))[0]

    def _predicted(
        self, readings: np.ndarray, alone: Motion, start: np.ndarray | None = None
    ) -> tuple[Motion, np.ndarray]:
        """Where the model alone predicts the poses `alone`; and the refined configurations (n, n_joints), searched
        from `start`, as far as they are known."""
        share = self.correction.share(readings)
        rows = np.flatnonzero(share > 0)
        closed = np.tile(self.refined.chain.home, (len(readings), 1)) if start is None else start.copy()
        if not len(rows):
            return alone, closed
        closure = self.close(readings[rows], None if start is None else start[rows])
        rows, poses = rows[closure.closed], closure.pose[closure.closed]  # where it can't be closed it says nothing
        closed[rows] = closure.q[closure.closed]
        corrected, model, part = self.refined.measured(poses), alone[rows], share[rows, None]
        turned = model.rotation @ exp(part * log(model.rotation.swapaxes(1, 2) @ corrected.rotation))
        moved = model.translation + part * (corrected.translation - model.translation)
        rotation, translation = alone.rotation.copy(), alone.translation.copy()
        rotation[rows], translation[rows] = turned, moved
        return Motion(rotation, translation), closed

    def command(self, desired: Motion, channels: tuple[str, ...] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
        """The geometric command of a goal that is moved by what the correction does there; each step gains digits,
        and starts where the step before ended."""
        if self.correction.shrinkage == 0.0:
            return self.geometric.command(desired, channels)
        robot, gain = self.geometric.robot, self.refined.actuators.gain
        solution, met = Goal.of(robot, desired, channels).solve()
        readings, refined, still = (
            self.geometric.readings(solution),
            solution.q.copy(),
            np.zeros(len(solution.q), dtype=bool),
        )
        for _ in range(_ITERATIONS):
            going = np.flatnonzero(met & ~still)
            if not len(going):
                break
            near = solution[going]
            alone = robot.measured(near.pose)
            here, refined[going] = self._predicted(readings[going], alone, refined[going])
            wanted = Goal.of(robot, desired[going], channels).filled(here)
            # what geometry must be asked for, so that the prediction is what is wanted
            aim = Motion(
                wanted.rotation @ here.rotation.swapaxes(1, 2) @ alone.rotation,
                wanted.translation + alone.translation - here.translation,
            )
            stepped, met[going] = Goal.of(robot, aim, channels).solve(near)
            solution = solution.replaced(going, stepped)
            before, readings[going] = readings[going], self.geometric.readings(stepped)
            still[going] = np.abs(gain * (readings[going] - before)).max(axis=1) < _STILL
        return readings, met & still & self._on_branch(readings, solution, refined)

    def _on_branch(self, readings: np.ndarray, solution: Closure, refined: np.ndarray) -> np.ndarray:
        """(n,): whether the readings lead from home to these configurations, of both models."""
        alone = self.geometric.robot.measured(solution.pose)
        (here, _), (from_home, _) = (self._predicted(readings, alone, start) for start in (refined, None))
        apart = np.abs(here.rotation - from_home.rotation).max(axis=(1, 2))
        apart = np.maximum(apart, np.abs(here.translation - from_home.translation).max(axis=1))
        return self.geometric.on_branch(readings, solution) & (apart < _REACHED)


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
            error, slope, closure = self._linearised(goal[going], readings[going], q[going])
            going, error, slope = going[closure.closed], error[closure.closed][:, axes], slope[closure.closed][:, axes]
            q[going] = closure.q[closure.closed]
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
        closure = robot.close(readings, q)
        tool = goal.tool(chart.posed(y, closure.pose.rotation))
        by_actuators = np.linalg.pinv(np.nan_to_num(actuator_jacobian(robot.chain, closure.q)))
        rates = goal.rates(closure.q) @ (by_actuators * robot.actuators.gain)
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


def build(
    model: ErrorModel, fit: Fit, learned: Learned | None, corrected: Corrected | None, channels: tuple[str, ...]
) -> Mapping[str, Method]:
    """{name: method} of one fit, in the table's order; without the learned ones where they are not given."""
    nominal, identified = model.robot(fit.registered), model.robot(fit.identified)
    geometric = ModelMethod(identified)
    methods: dict[str, Method] = {"nominal": ModelMethod(nominal, "nominal"), "geometric": geometric}
    if learned is not None:
        as_drawn, as_built = Chart(nominal, channels), Chart(identified, channels)
        methods["network"] = NetworkMethod(learned.network, as_drawn)
        methods["transfer"] = NetworkMethod(learned.transfer, as_drawn)
        methods["transfer_identified"] = NetworkMethod(learned.transfer_identified, as_built)
    if corrected is not None:
        methods["hybrid"] = HybridMethod(geometric, model.robot(corrected.refined), corrected.correction)
    return methods


def uncalibrated(model: ErrorModel) -> Method:
    """The nominal robot with W = T = 1."""
    return ModelMethod(model.robot(np.zeros(len(model.parameters))), "nominal")
