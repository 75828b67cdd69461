"""The compensator at control rate: what the generated C is made of, and how many iterations it needs.

What `Method.command` finds for batches is found pose by pose, in a bounded number of Newton steps: inverse kinematics
until it is rough, then steps that take the correction along. The loops here are those of `templates/compensator.c`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from kincal.identification.compiled import compiled
from kincal.identification.error_model import BuiltRobot
from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.steps import Steps, steps
from kincal.pipeline.methods.goal import Goal
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.urdf.description import Workspace
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import bounds, grid, sample

SETTLED = 1e-10  # of a joint [m, rad]: what the last step leaves, by the rate at which steps become shorter
SURE = 1e-7  # of a joint [m, rad]: the longest last step
ROUGH = 1e-3  # of a joint [m, rad]: near enough to take the correction along
SLACK = 1e-9  # of joint limits and the workspace [m, rad]
LONGEST = 0.6  # step of one joint [m, rad], as in `urdf.kinematics`
_TRIED = 50  # iterations
_SPARE = 2  # iterations more than any pose needed
_POSES = 300  # at which iterations are counted, besides the workspace's corners
_ORDERED = 40  # configurations that decide in which order linear systems are solved

Advance = Callable[[np.ndarray], np.ndarray]  # rows -> the length of each one's step


@dataclass(frozen=True)
class Most:
    """Iterations of each loop, never more."""

    inverse: int
    hybrid: int
    forward: int


@dataclass(frozen=True)
class Commanded:
    """Commands for n desired poses."""

    readings: np.ndarray  # (n, n_actuated)
    reached: np.ndarray  # (n,) there, and on home's assembly branch
    iterations: np.ndarray  # (n, 2) with the model alone, and with the correction


@dataclass(frozen=True)
class Compensator:
    """All that the generated code is made of. Joints are in the chain's order."""

    method: ModelMethod | HybridMethod
    robot: BuiltRobot  # of the method, without a correction
    asked: frozenset[str]  # of desired poses: see `Goal`
    steps: Steps
    home: np.ndarray  # (n_joints,) closed, with the tool at home
    apart: np.ndarray  # (n_passive,) by how much the refined robot's passive joints are ahead there
    signs: tuple[float, ...]  # there, of the branches of `inverse`, `forward` and `refined`
    workspace: np.ndarray  # (n_tool_axes, 2) [m, rad]
    most: Most

    @staticmethod
    def of(method: ModelMethod | HybridMethod, channels: tuple[str, ...], workspace: Workspace) -> Compensator:
        """channels: the parts of desired poses that count, as in `Method.command`.

        Raises InputError where they do not decide what the tool does, CalibrationError where Newton's method does not
        get everywhere in the workspace.
        """
        if isinstance(method, HybridMethod) and method.correction.shrinkage == 0.0:
            method = method.geometric  # which it is, to the last bit
        robot = method.geometric.robot if isinstance(method, HybridMethod) else method.robot
        chain, at_home = robot.chain, inverse(robot.chain, np.zeros((1, 6)))
        goal = Goal.of(robot, robot.measured(at_home.pose), channels)
        if not goal.whole and not goal.decided():
            raise InputError(f"--format c: what is measured, {', '.join(channels)}, does not decide what the tool does")
        spread = inverse(chain, sample(workspace, chain.tool_axes, _ORDERED, [0, 41]))
        made = steps(method, goal.asked, spread.q[spread.closed])
        branches = [_call(made.inverse, at_home.q, *_given(goal.desired))[1], _call(made.forward, at_home.q)[1]]
        apart = np.zeros(len(chain.passive))
        if isinstance(method, HybridMethod):
            refined = method.close(_readings(robot, at_home.q)).q
            apart = (refined - at_home.q)[0, chain.passive]
            branches.append(_call(made.refined, refined)[1])
        signs = tuple(float(np.sign(b[0, 0])) for b in branches)
        compensator = Compensator(
            method, robot, goal.asked, made, at_home.q[0], apart, signs, bounds(workspace), Most(0, 0, 0)
        )
        return replace(compensator, most=compensator._needed(workspace))

    def compiled(self) -> Compensator:
        """The same with its steps as machine code, for many thousand poses; as it is where there is no compiler."""
        functions: dict[str, Any] = {name: f and compiled(f) for name, f in vars(self.steps).items()}
        return replace(self, steps=replace(self.steps, **functions))

    def commands(self, desired: Motion) -> Commanded:
        """For desired poses (n), each searched from home: what `Method.command` finds, as the generated C does."""
        n, given = len(desired.translation), _given(desired)
        q, apart, on_branch = np.tile(self.home, (n, 1)), np.tile(self.apart, (n, 1)), np.zeros(n, dtype=bool)

        def model_alone(rows: np.ndarray) -> np.ndarray:
            step, branch = _call(self.steps.inverse, q[rows], *(g[rows] for g in given))
            on_branch[rows] = branch[:, 0] * self.signs[0] > 0
            return _take(q, rows, step)

        def corrected(rows: np.ndarray) -> np.ndarray:
            size, (delta, share) = np.zeros(len(rows)), _call(self.steps.network, _readings(self.robot, q[rows]))
            on = share[:, 0] > 0
            size[~on] = model_alone(rows[~on])
            good_rows = rows[on]
            step, branch, ahead, also = _call(
                self.steps.hybrid, q[good_rows], apart[good_rows], delta[on], share[on], *(g[good_rows] for g in given)
            )
            on_branch[good_rows] = (branch[:, 0] * self.signs[0] > 0) & (also[:, 0] * self.signs[2] > 0)
            size[on] = np.maximum(_take(q, good_rows, step), _take(apart, good_rows, ahead))
            return size

        first, reached = _iterate(model_alone, n, rough=self.steps.hybrid is not None)
        second = np.zeros(n, dtype=int)
        if self.steps.hybrid is not None:
            second, settled = _iterate(corrected, n, rough=False)
            reached = reached & settled
        reached = reached & on_branch & (_call(self.steps.forward, q)[1][:, 0] * self.signs[1] > 0)
        return Commanded(_readings(self.robot, q), reached, np.stack([first, second], axis=1))

    def _needed(self, workspace: Workspace) -> Most:
        """What suffices all over the workspace, from home; and some to spare."""
        chain = self.robot.chain
        u = np.concatenate(
            [
                sample(workspace, chain.tool_axes, _POSES, [0, 42]),
                grid(workspace, chain.tool_axes, [2] * len(chain.tool_axes)),
            ]
        )
        closure = inverse(chain, u)
        readings = _readings(self.robot, closure.q[closure.closed])
        commands = self.commands(self.method.predict(readings))
        closing, closed = self._closing(readings)
        lost = int(np.sum(~(commands.reached & closed)))
        if lost:
            raise CalibrationError(
                f"--format c: Newton's method does not get from home to {lost} of {len(readings)} poses of the "
                "workspace; nothing was exported"
            )
        first, second = commands.iterations.max(axis=0)
        corrects = self.steps.hybrid is not None
        return Most(int(first) + _SPARE, corrects * (int(second) + _SPARE), int(closing.max()) + _SPARE)

    def _closing(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Iterations (n,) in which the loops close at readings (n, n_actuated) from home, and where they do."""
        chain, q = self.robot.chain, np.tile(self.home, (len(readings), 1))
        q[:, chain.actuated] = self.robot.actuators.joints(readings)
        passive = q[:, chain.passive]

        def close(rows: np.ndarray) -> np.ndarray:
            q[np.ix_(rows, chain.passive)] = passive[rows]
            return _take(passive, rows, _call(self.steps.forward, q[rows])[0])

        return _iterate(close, len(readings), rough=False)


def _iterate(advance: Advance, n: int, rough: bool) -> tuple[np.ndarray, np.ndarray]:
    """Iterations that each of n rows takes, and whether it settles."""
    taken, before, going = np.full(n, _TRIED), np.zeros(n), np.arange(n)
    for k in range(1, _TRIED + 1):
        size = advance(going)
        slower = size >= before[going]
        left = size * np.where(slower, 1.0, size / np.where(slower, 1.0, before[going]))
        done = size <= ROUGH if rough else (left <= SETTLED) & (size <= SURE)
        before[going], taken[going] = size, k
        going = going[~done]
        if not len(going):
            break
    return taken, ~np.isin(np.arange(n), going)


def _take(joints: np.ndarray, rows: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Subtracts steps (k, m) from rows of joints (n, m), the long ones shortened; their lengths (k,)."""
    size = np.abs(step).max(axis=1, initial=0.0)
    joints[rows] -= step * np.minimum(1.0, LONGEST / np.maximum(size, LONGEST))[:, None]
    return size


def _readings(robot: BuiltRobot, q: np.ndarray) -> np.ndarray:
    return robot.actuators.readings(q[:, robot.chain.actuated])


def _given(desired: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and quaternions (n, 4)."""
    return desired.translation, quaternions(desired.rotation)


def _call(function: ca.Function | None, *inputs: np.ndarray) -> list[np.ndarray]:
    """A function of one pose at n poses: inputs and outputs are (n, ..)."""
    assert function is not None
    n = len(inputs[0])
    outputs = [np.zeros((n, function.numel_out(k))) for k in range(function.n_out())]
    if n:
        buffer, run = function.map(n).buffer()
        given = [np.ascontiguousarray(np.reshape(i, (n, -1)), dtype=float) for i in inputs]
        for k, value in enumerate(given):
            buffer.set_arg(k, memoryview(value))  # pyright: ignore
        for k, value in enumerate(outputs):
            buffer.set_res(k, memoryview(value))  # pyright: ignore
        run()
    return outputs
