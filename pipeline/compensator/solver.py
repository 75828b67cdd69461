"""Commands of a model, with or without a correction: Newton's method, pose by pose, in a bounded number of steps.

Inverse kinematics until it is rough, then steps that take the correction along. The loops here are those of
`templates/compensator.c`, on whole batches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from kincal.identification.compiled import compiled
from kincal.identification.error_model import BuiltRobot
from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.functions import call
from kincal.pipeline.compensator.goal import Goal
from kincal.pipeline.compensator.steps import Steps, steps
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.urdf.description import Workspace
from kincal.urdf.kinematics import Closure, inverse, tool_pose, tree
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import sample

SETTLED = 1e-10  # of a joint [m, rad]: what the last step leaves, by the rate at which steps become shorter
SURE = 1e-7  # of a joint [m, rad]: the longest last step
ROUGH = 1e-3  # of a joint [m, rad]: near enough to take the correction along
LONGEST = 0.6  # step of one joint [m, rad], as in `urdf.kinematics`
_BRANCH = 1e-6  # of a pose [m, rad]: assembly branches are further apart
_TRIED = 50  # iterations
_ORDERED = 40  # configurations that decide in which order linear systems are solved

Advance = Callable[[np.ndarray], np.ndarray]  # rows -> the length of each one's step


@dataclass(frozen=True)
class Commanded:
    """Commands for n desired poses."""

    readings: np.ndarray  # (n, n_actuated)
    reached: np.ndarray  # (n,) the method predicts the desired pose there, on home's assembly branch


class Solver(Protocol):
    """Finds the commands of one method."""

    def commands(self, desired: Motion) -> Commanded:
        """Readings that reach desired poses (n) in the measurement frame, as far as they can be reached.

        A robot with fewer axes than six reaches the desired tool pose's coordinates on its tool axes; the others, and
        what is not asked for, are as the method predicts them there.
        """
        ...


@dataclass(frozen=True)
class Iterated(Commanded):
    """With what it took."""

    iterations: np.ndarray  # (n, 2) with the model alone, and with the correction


@dataclass(frozen=True)
class ModelSolver:
    """Of a method that is a model. Joints are in the chain's order."""

    method: ModelMethod | HybridMethod
    goal: Goal
    steps: Steps
    home: np.ndarray  # (n_joints,) closed, with the tool at home
    apart: np.ndarray  # (n_passive,) by how much the refined robot's passive joints are ahead there

    @staticmethod
    def of(method: ModelMethod | HybridMethod, channels: tuple[str, ...], workspace: Workspace) -> ModelSolver:
        """channels: the parts of desired poses that count."""
        if isinstance(method, HybridMethod) and method.correction.shrinkage == 0.0:
            method = method.geometric  # which it is, to the last bit
        robot = method.geometric.robot if isinstance(method, HybridMethod) else method.robot
        chain, at_home = robot.chain, inverse(robot.chain, np.zeros((1, 6)))
        goal = Goal.of(robot, channels)
        spread = inverse(chain, sample(workspace, chain.tool_axes, _ORDERED, [0, 41]))
        made = steps(method, goal, np.concatenate([at_home.q, spread.q[spread.closed]]))
        apart = np.zeros(len(chain.passive))
        if isinstance(method, HybridMethod):
            refined = method.close(readings(robot, at_home.q)).q
            apart = (refined - at_home.q)[0, chain.passive]
        return ModelSolver(method, goal, made, at_home.q[0], apart)

    @property
    def robot(self) -> BuiltRobot:
        """Of the method, without a correction."""
        return self.goal.robot

    def compiled(self) -> ModelSolver:
        """The same with its steps as machine code, for many thousand poses; as it is where there is no compiler."""
        functions: dict[str, Any] = {name: f and compiled(f) for name, f in vars(self.steps).items()}
        return replace(self, steps=replace(self.steps, **functions))

    def commands(self, desired: Motion) -> Iterated:
        """For desired poses (n), each searched from home, as the generated C does."""
        n, wanted = len(desired.translation), (desired.translation, quaternions(desired.rotation))
        q, apart, share = np.tile(self.home, (n, 1)), np.tile(self.apart, (n, 1)), np.zeros((n, 1))

        def model_alone(rows: np.ndarray) -> np.ndarray:
            return _take(q, rows, call(self.steps.inverse, q[rows], *(w[rows] for w in wanted))[0])

        def corrected(rows: np.ndarray) -> np.ndarray:
            size = np.zeros(len(rows))
            delta, share[rows] = call(self.steps.network, readings(self.robot, q[rows]))
            believed = share[rows, 0] > 0
            size[~believed] = model_alone(rows[~believed])
            rows = rows[believed]
            step, _, ahead, _ = call(
                self.steps.hybrid, q[rows], apart[rows], delta[believed], share[rows], *(w[rows] for w in wanted)
            )
            size[believed] = np.maximum(_take(q, rows, step), _take(apart, rows, ahead))
            return size

        first, reached = _iterate(model_alone, n, rough=self.steps.hybrid is not None)
        second = np.zeros(n, dtype=int)
        if self.steps.hybrid is not None:
            second, settled = _iterate(corrected, n, rough=False)
            reached = reached & settled
            corrected(np.flatnonzero(reached))  # such steps gain a few digits each: one more than control rate needs
        rows = np.flatnonzero(reached)
        reached[rows] = self._from_home(q[rows], apart[rows], share[rows])
        return Iterated(readings(self.robot, q), reached, np.stack([first, second], axis=1))

    def closing(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Iterations (n,) in which the loops close at readings (n, n_actuated) from home, and whether they do: (n,)."""
        chain, q = self.robot.chain, np.tile(self.home, (len(at), 1))
        q[:, chain.actuated] = self.robot.actuators.joints(at)
        passive = q[:, chain.passive]

        def close(rows: np.ndarray) -> np.ndarray:
            size = _take(passive, rows, call(self.steps.forward, q[rows])[0])
            q[np.ix_(rows, chain.passive)] = passive[rows]
            return size

        return _iterate(close, len(q), rough=False)

    def _from_home(self, q: np.ndarray, apart: np.ndarray, share: np.ndarray) -> np.ndarray:
        """(n,): whether the readings lead from home to these configurations, and not to another assembly branch."""
        at = readings(self.robot, q)
        good = _same(self.robot, q, self.robot.close(at))
        rows = np.flatnonzero(share[:, 0] > 0)
        if len(rows):
            assert isinstance(self.method, HybridMethod)
            chain, refined, closure = self.robot.chain, q[rows], self.method.close(at[rows])
            refined[:, chain.actuated] = closure.q[:, chain.actuated]
            refined[:, chain.passive] += apart[rows]
            good[rows] &= _same(self.method.refined, refined, closure)
        return good


def _same(robot: BuiltRobot, q: np.ndarray, closure: Closure) -> np.ndarray:
    """(n,): whether the tool is at configurations q: (n, n_joints) where it is in closed ones."""
    pose = tool_pose(robot.chain, tree(robot.chain, q))
    apart = np.abs(pose.rotation - closure.pose.rotation).max(axis=(1, 2))
    return closure.closed & (
        np.maximum(apart, np.abs(pose.translation - closure.pose.translation).max(axis=1)) < _BRANCH
    )


def _iterate(advance: Advance, n: int, rough: bool) -> tuple[np.ndarray, np.ndarray]:
    """Iterations that each of n rows takes, and whether it settles."""
    taken, before, going = np.full(n, _TRIED), np.zeros(n), np.arange(n)
    for k in range(1, _TRIED + 1):
        size = advance(going)
        slower = size >= before[going]
        left = size * np.where(slower, 1.0, size / np.where(slower, 1.0, before[going]))
        done = size <= ROUGH if rough else (left <= SETTLED) & (size <= SURE)
        before[going], taken[going] = size, k
        going = going[~done & np.isfinite(size)]
        if not len(going):
            break
    settled = np.ones(n, dtype=bool)
    settled[going] = False
    return taken, settled & np.isfinite(before)


def _take(joints: np.ndarray, rows: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Subtracts steps (k, m) from rows of joints (n, m), the long ones shortened; their lengths (k,)."""
    size = np.abs(step).max(axis=1, initial=0.0)
    joints[rows] -= step * np.minimum(1.0, LONGEST / np.maximum(size, LONGEST))[:, None]
    return size


def readings(robot: BuiltRobot, q: np.ndarray) -> np.ndarray:
    """(n, n_actuated) at configurations (n, n_joints)."""
    return robot.actuators.readings(q[:, robot.chain.actuated])
