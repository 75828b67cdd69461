"""Commands that reach desired poses, and the obstacles of those that cannot be reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.pipeline.compensator.solver import Solver
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Workspace
from kincal.urdf.errors import UnreachablePoseError
from kincal.urdf.kinematics import Closure, forward, tool_coordinates
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import beyond_limits, bounds, condition_numbers

_SLACK = 0.05  # of the workspace's size: an actual robot is a little beside the nominal one


@dataclass(frozen=True)
class Attempt:
    """Readings (n, n_actuated) for desired poses (n), and what stands in the way of each."""

    readings: np.ndarray
    reached: np.ndarray  # (n,) the method's own prediction is the desired pose, as far as it can be
    closure: Closure  # of the nominal robot there
    condition: np.ndarray  # (n,) its condition numbers

    def good(self, chain: ClosedChain, workspace: Workspace) -> np.ndarray:
        """(n,) reached, closed, within the joint limits and away from singularities."""
        inside = ((self.closure.q >= chain.lower) & (self.closure.q <= chain.upper)).all(axis=1)
        return self.reached & self.closure.closed & inside & (self.condition <= workspace.max_condition)


def attempt(solver: Solver, desired: Motion, chain: ClosedChain, actuators: Actuators) -> Attempt:
    """The commands for desired poses (n) in the measurement frame; chain and actuators are the nominal ones."""
    commanded = solver.commands(desired)
    closure = forward(chain, actuators.joints(commanded.readings))
    return Attempt(commanded.readings, commanded.reached, closure, condition_numbers(chain, closure.q))


@dataclass(frozen=True)
class Commands:
    """What reaches desired poses."""

    poses: np.ndarray  # (n,) their numbers
    readings: np.ndarray  # (n, n_actuated)
    obstacles: tuple[str, ...]  # (n,) why a pose can't be reached; empty where it can
    outside: np.ndarray  # (n,) bool: reached, but outside the workspace

    def check(self) -> None:
        """Raises UnreachablePoseError that names the first pose that can't be reached."""
        for number, obstacle in zip(self.poses, self.obstacles, strict=True):
            if obstacle:
                raise UnreachablePoseError(f"pose {number}{obstacle}", int(number))


def commands(
    solver: Solver, desired: Motion, chain: ClosedChain, actuators: Actuators, workspace: Workspace, poses: np.ndarray
) -> Commands:
    """Readings that reach desired poses (n), numbered `poses` (n,), as far as they can be reached."""
    tried = attempt(solver, desired, chain, actuators)
    outside = tried.good(chain, workspace) & ~_inside(tried, chain, workspace)
    return Commands(poses, tried.readings, _obstacles(tried, chain, workspace), outside)


def _inside(tried: Attempt, chain: ClosedChain, workspace: Workspace) -> np.ndarray:
    """(n,) whether the nominal tool is in the workspace there, or beside it by a small part of its size."""
    low, high = bounds(workspace).T
    slack = _SLACK * (high - low)
    u = tool_coordinates(chain, tried.closure.pose)[:, list(chain.tool_axes)]
    return ((u >= low - slack) & (u <= high + slack)).all(axis=1)


def _obstacles(tried: Attempt, chain: ClosedChain, workspace: Workspace) -> tuple[str, ...]:
    """(n,) what stands in the way of each command, to be said after the pose's number; empty where nothing does."""
    obstacles = np.full(len(tried.readings), "", dtype=object)
    # what matters most comes last
    obstacles[tried.condition > workspace.max_condition] = (
        f" is near a singularity (condition number beyond max_condition = {workspace.max_condition:g})"
    )
    for row, message in beyond_limits(chain, tried.closure.q).items():
        obstacles[row] = f": {message}"
    obstacles[~tried.closure.closed] = " can't be reached: the loops don't close there"
    obstacles[~tried.reached] = " can't be reached"
    return tuple(obstacles)
