"""The command that reaches the desired pose: predict(q) = desired, in the measurement frame, batched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.pipeline.methods.goal import WHOLE
from kincal.pipeline.methods.predictors import Method
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import Closure, forward
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import check_limits, condition_numbers


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


def attempt(
    method: Method, desired: Motion, chain: ClosedChain, actuators: Actuators, channels: tuple[str, ...] = WHOLE
) -> Attempt:
    """The commands for desired poses (n) in the measurement frame; chain and actuators are the nominal ones.

    channels: the parts of the desired poses that are known, as in `Method.command`.
    """
    readings, reached = method.command(desired, channels)
    closure = forward(chain, actuators.joints(readings))
    return Attempt(readings, reached, closure, condition_numbers(chain, closure.q))


def commands(
    method: Method,
    desired: Motion,
    chain: ClosedChain,
    actuators: Actuators,
    workspace: Workspace,
    poses: np.ndarray,
    channels: tuple[str, ...] = WHOLE,
) -> np.ndarray:
    """Readings (n, n_actuated) that reach desired poses (n), numbered `poses` (n,).

    Raises InputError that names the first pose that can't be reached, breaks a joint limit or is near a singularity.
    """
    tried = attempt(method, desired, chain, actuators, channels)
    _refuse(~tried.reached, poses, "can't be reached")
    _refuse(~tried.closure.closed, poses, "can't be reached: the loops don't close there")
    check_limits(chain, tried.closure.q, lambda row: f"pose {poses[row]}")
    why = f"is near a singularity (condition number beyond max_condition = {workspace.max_condition:g})"
    _refuse(tried.condition > workspace.max_condition, poses, why)
    return tried.readings


def _refuse(bad: np.ndarray, poses: np.ndarray, why: str) -> None:
    if bad.any():
        raise InputError(f"pose {poses[int(np.argmax(bad))]} {why}")
