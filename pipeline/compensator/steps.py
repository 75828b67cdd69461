"""One step of all that a compensator solves, as CasADi functions of scalars: for one pose, for generated code.

`inverse` and `hybrid` are Newton steps towards a desired pose, `forward` and `refined` of loop closures. All are exact
but for one: a hybrid step takes the correction for constant, so each gains as many digits as it is flat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from kincal.identification.elimination import eliminate
from kincal.identification.error_model import BuiltRobot
from kincal.identification.symbolic_chain import (
    Placement,
    joint_frames,
    loop_equations,
    loop_rates,
    rotation_matrix,
    rotation_vector,
    tool_placement,
    tool_rates,
)
from kincal.learning.symbolic import delta, share
from kincal.pipeline.compensator.functions import function
from kincal.pipeline.compensator.goal import Goal, constant, coordinates, in_base, measured, rotation_of, symbols
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.urdf.rigid_motion import Motion

_STILL = (ca.DM.eye(3), ca.DM.zeros(3))


@dataclass(frozen=True)
class Steps:
    """Functions of one pose. Inputs are q: (n_joints,), desired position (3,) and quaternion (4,), and others' outputs.

    A step is what to subtract. A branch is a determinant: its sign is home's on home's assembly branch. `apart`
    (n_passive,) is by how much the refined robot's passive joints are ahead of q's.
    """

    inverse: ca.Function  # q, position, quaternion -> step (n_joints,), branch
    forward: ca.Function  # q -> step (n_passive,), branch
    pose: ca.Function  # q -> rotation (3, 3), position
    coordinates: ca.Function  # rotation (3, 3) and position of a prediction -> tool coordinates (n_tool_axes,)
    network: ca.Function | None = None  # readings -> delta (n_actuated,), share
    # q, apart, delta, share, position, quaternion -> the same as inverse, step of apart (n_passive,), its branch
    hybrid: ca.Function | None = None
    refined: ca.Function | None = None  # q of the refined robot -> step (n_passive,), branch
    blended: ca.Function | None = None  # q, q of the refined robot, share -> rotation (3, 3), position

    def all(self) -> list[ca.Function]:
        return [function for function in vars(self).values() if function is not None]


@dataclass(frozen=True)
class _Walked:
    """A robot at symbolic joints."""

    robot: BuiltRobot
    q: ca.SX
    loops: ca.SX  # (n_equations,)
    loop_rates: ca.SX  # (n_equations, n_joints)
    tool_rates: ca.SX  # (6, n_joints)
    tool: Placement
    predicted: Placement  # W * tool * T

    @staticmethod
    def of(robot: BuiltRobot) -> _Walked:
        chain = robot.chain
        q = ca.SX.sym("q", chain.n_joints)
        placed = [constant(Motion(r, t)) for r, t in zip(chain.rotation, chain.translation, strict=True)]
        frames = joint_frames(chain, q, placed)
        tool = tool_placement(chain, frames)
        loops, rates = loop_equations(chain, frames, placed), loop_rates(chain, frames, placed)
        return _Walked(robot, q, loops, rates, tool_rates(chain, frames), tool, measured(robot, tool))


def steps(method: ModelMethod | HybridMethod, goal: Goal, samples: np.ndarray) -> Steps:
    """goal: the parts of desired poses that count; samples: (m, n_joints), configurations all over the workspace.

    The samples decide in which order linear systems are solved.
    """
    walked = _Walked.of(method.geometric.robot if isinstance(method, HybridMethod) else method.robot)
    position, quaternion = ca.SX.sym("position", 3), ca.SX.sym("quaternion", 4)
    desired, seen = (rotation_of(quaternion), position), symbols()
    geometric = Steps(
        function("inverse", [walked.q, position, quaternion], _inverse(walked, goal, desired, _STILL, samples)),
        function("forward", [walked.q], _closing(walked, samples)),
        function("pose", [walked.q], walked.predicted),
        function("coordinates", list(seen), [coordinates(walked.robot.chain, in_base(walked.robot, seen))]),
    )
    if not isinstance(method, HybridMethod):
        return geometric
    correction, refined = method.correction, _Walked.of(method.refined)
    readings, part = ca.SX.sym("readings", correction.units.n_joints), ca.SX.sym("share")
    shift, apart = ca.SX.sym("delta", readings.shape[0]), ca.SX.sym("apart", len(walked.robot.chain.passive))
    step, branch, closed = _closed_beside(walked, refined, shift, apart, samples)
    further = _further(*closed, part)
    solved = [*_inverse(walked, goal, desired, further, samples), step, branch]
    return replace(
        geometric,
        network=function("network", [readings], [delta(correction, readings), share(correction, readings)]),
        hybrid=function("hybrid", [walked.q, apart, shift, part, position, quaternion], solved),
        refined=function("refined", [refined.q], _closing(refined, samples)),
        blended=function("blended", [walked.q, refined.q, part], _blended(walked.predicted, refined.predicted, part)),
    )


def _inverse(
    walked: _Walked, goal: Goal, desired: Placement, further: Placement, samples: np.ndarray
) -> tuple[ca.SX, ca.SX]:
    """Newton's step of inverse kinematics, and its branch.

    further: by how much the prediction is ahead of the model's, taken for constant (see `missed`).
    """
    error, jacobian = _equations(walked, goal, desired, further)
    _, where_met = _equations(walked, goal, walked.predicted, _STILL)
    return eliminate(jacobian, error, _values(walked.q, where_met, samples))


def _equations(walked: _Walked, goal: Goal, desired: Placement, further: Placement) -> tuple[ca.SX, ca.SX]:
    """(n_joints,): open loops and what is missed of the goal; (n_joints, n_joints): how joints change them."""
    tool, aim, ahead = symbols(), symbols(), symbols()
    error = goal.missed(tool, aim, ahead)
    small = ca.SX.sym("small", 6)
    moved = ((ca.SX.eye(3) + ca.skew(small[3:])) @ tool[0], tool[1] + small[:3])
    rates = ca.jacobian(goal.missed(moved, aim, ahead), small)
    rates = ca.substitute([rates], [small], [ca.SX.zeros(6)])[0]
    values = [ca.densify(part) for part in (*walked.tool, *desired, *further)]
    error, rates = ca.substitute([error, rates], [*tool, *aim, *ahead], values)
    return ca.vertcat(walked.loops, error), ca.vertcat(walked.loop_rates, rates @ walked.tool_rates)


def _closing(walked: _Walked, samples: np.ndarray) -> tuple[ca.SX, ca.SX]:
    """Newton's step of the passive joints that closes the loops, and its branch."""
    jacobian = walked.loop_rates[:, walked.robot.chain.passive.tolist()]
    return eliminate(jacobian, walked.loops, _values(walked.q, jacobian, samples))


def _closed_beside(
    walked: _Walked, refined: _Walked, shift: ca.SX, apart: ca.SX, samples: np.ndarray
) -> tuple[ca.SX, ca.SX, tuple[Placement, Placement]]:
    """The refined robot beside q, at the same readings with their correction `shift`.

    Returns the step of `apart`, its branch, and both robots' predictions with their loops closed at these readings: to
    first order, and q's by the refined robot's Jacobian. What that leaves out is gone when the steps are.
    """
    chain, actuators = refined.robot.chain, refined.robot.actuators
    actuated, passive = chain.actuated.tolist(), chain.passive.tolist()
    readings = (walked.q[actuated] - walked.robot.actuators.zero) / walked.robot.actuators.gain
    beside = ca.SX(walked.q)
    beside[actuated] = actuators.zero + actuators.gain * readings + shift
    beside[passive] += apart
    jacobian = refined.loop_rates[:, passive]
    steps, branch = eliminate(jacobian, ca.horzcat(refined.loops, walked.loops), _values(refined.q, jacobian, samples))
    predictions = []
    for robot, step in ((refined, steps[:, 0]), (walked, steps[:, 1])):
        whole = ca.SX.zeros(chain.n_joints)
        whole[passive] = -step
        predictions += [part + ca.jtimes(part, robot.q, whole) for part in robot.predicted]
    step, branch, *parts = ca.substitute([steps[:, 0], branch, *predictions], [refined.q], [beside])
    return step, branch, ((parts[2], parts[3]), (parts[0], parts[1]))


def _further(alone: Placement, corrected: Placement, part: ca.SX) -> Placement:
    """`part` of the way from the model alone to the corrected one: a turn in the target's frame, and a move."""
    turn = rotation_matrix(part * rotation_vector(alone[0].T @ corrected[0]))
    return turn, part * (corrected[1] - alone[1])


def _blended(alone: Placement, corrected: Placement, part: ca.SX) -> Placement:
    turn, move = _further(alone, corrected, part)
    return alone[0] @ turn, alone[1] + move


def _values(q: ca.SX, matrix: ca.SX, samples: np.ndarray) -> np.ndarray:
    """(m, ..): a matrix of joints at samples (m, n_joints)."""
    evaluate = ca.Function("matrix", [q], [matrix])
    return np.array([evaluate(sample).full() for sample in samples])
