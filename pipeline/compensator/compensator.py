"""The compensator at control rate: what the generated C is made of, and how many iterations it needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.functions import call
from kincal.pipeline.compensator.solver import ModelSolver, readings
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.urdf.description import Workspace
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import inverse
from kincal.urdf.workspace import bounds, grid, sample

SLACK = 1e-9  # of joint limits and the workspace [m, rad]
_SPARE = 2  # iterations more than any pose needed
_POSES = 300  # at which iterations are counted, besides the workspace's corners


@dataclass(frozen=True)
class Most:
    """Iterations of each loop, never more."""

    inverse: int
    hybrid: int
    forward: int


@dataclass(frozen=True)
class Compensator:
    """All that the generated code is made of."""

    solver: ModelSolver
    signs: tuple[float, ...]  # at home, of the branches of `inverse`, `forward` and `refined`
    workspace: np.ndarray  # (n_tool_axes, 2) [m, rad]
    most: Most

    @staticmethod
    def of(method: ModelMethod | HybridMethod, channels: tuple[str, ...], workspace: Workspace) -> Compensator:
        """channels: the parts of desired poses that count.

        Raises InputError where they do not decide what the tool does, CalibrationError where Newton's method does not
        get everywhere in the workspace.
        """
        solver = ModelSolver.of(method, channels, workspace)
        if not solver.goal.decided:
            raise InputError(
                f"--format c: the measured channel, {', '.join(channels)}, does not determine the pose of the tool"
            )
        return Compensator(solver, _signs(solver), bounds(workspace), _needed(solver, workspace))


def _signs(solver: ModelSolver) -> tuple[float, ...]:
    home, robot, steps = solver.home[None], solver.robot, solver.steps
    at_home = robot.measured(inverse(robot.chain, np.zeros((1, 6))).pose)
    desired = at_home.translation, quaternions(at_home.rotation)
    branches = [call(steps.inverse, home, *desired)[1], call(steps.forward, home)[1]]
    if isinstance(solver.method, HybridMethod):
        refined = solver.method.close(readings(robot, home)).q
        branches.append(call(steps.refined, refined)[1])
    return tuple(float(np.sign(b[0, 0])) for b in branches)


def _needed(solver: ModelSolver, workspace: Workspace) -> Most:
    """What suffices all over the workspace, from home; and some to spare."""
    chain = solver.robot.chain
    random = sample(workspace, chain.tool_axes, _POSES, [0, 42])
    corners = grid(workspace, chain.tool_axes, [2] * len(chain.tool_axes))
    closure = inverse(chain, np.concatenate([random, corners]))
    at = readings(solver.robot, closure.q[closure.closed])
    commanded = solver.commands(solver.method.predict(at))
    closing, closed = solver.closing(at)
    lost = int(np.sum(~(commanded.reached & closed)))
    if lost:
        raise CalibrationError(
            f"--format c: Newton's method does not get from home to {lost} of {len(at)} poses of the workspace; "
            "nothing was exported"
        )
    first, second = commanded.iterations.max(axis=0)
    corrects = solver.steps.hybrid is not None
    return Most(int(first) + _SPARE, corrects * (int(second) + _SPARE), int(closing.max()) + _SPARE)
