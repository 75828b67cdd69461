"""The command that reaches the desired pose: predict(q) = desired, in the measurement frame, batched."""

from __future__ import annotations

import numpy as np

from pipeline.methods import Method
from urdf.closed_chain import ClosedChain
from urdf.description import Workspace
from urdf.errors import InputError
from urdf.kinematics import forward
from urdf.rigid_motion import Motion
from urdf.workspace import condition_numbers

_LIMIT_SLACK = 1e-9


def commands(
    method: Method, desired: Motion, chain: ClosedChain, joints_of, workspace: Workspace, poses: np.ndarray
) -> np.ndarray:
    """Readings (n, n_actuated) that reach desired poses (n), numbered `poses` (n,), in the measurement frame.

    joints_of: readings to nominal joint values, by which limits and singularities of the nominal `chain` are judged.
    Raises InputError that names the first pose that can't be reached, breaks a joint limit or is near a singularity.
    """
    readings, reached = method.command(desired)
    _refuse(~reached, poses, "can't be reached")
    joints = joints_of(readings)
    low, high = chain.lower[chain.actuated] - _LIMIT_SLACK, chain.upper[chain.actuated] + _LIMIT_SLACK
    outside = (joints < low) | (joints > high)
    if outside.any():
        row, k = np.argwhere(outside)[0]
        raise InputError(
            f"pose {poses[row]}: joint {chain.actuated_names[k]!r} would be at {joints[row, k]:.6g}; "
            f"its limits are [{low[k]:.6g}, {high[k]:.6g}]"
        )
    closure = forward(chain, joints)
    _refuse(~closure.closed, poses, "can't be reached: the loops don't close there")
    condition = condition_numbers(chain, closure.q)
    near = condition > workspace.max_condition
    _refuse(near, poses, f"is near a singularity (condition number beyond max_condition = {workspace.max_condition:g})")
    return readings


def _refuse(bad: np.ndarray, poses: np.ndarray, why: str) -> None:
    if bad.any():
        raise InputError(f"pose {poses[int(np.argmax(bad))]} {why}")
