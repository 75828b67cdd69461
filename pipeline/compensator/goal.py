"""What a desired pose asks of a robot, as `Goal` has it, in CasADi expressions of one pose."""

from __future__ import annotations

import casadi as ca

from kincal.identification.channels import all_turns
from kincal.identification.error_model import BuiltRobot
from kincal.identification.symbolic_chain import Placement, after
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.rigid_motion import Motion


def constant(motion: Motion) -> Placement:
    return ca.DM(motion.rotation), ca.DM(motion.translation)


def measured(robot: BuiltRobot, tool: Placement) -> Placement:
    """W * tool pose * T."""
    return after(after(constant(robot.instrument), tool), constant(robot.target))


def coordinates(chain: ClosedChain, tool: Placement) -> ca.SX:
    """(n_tool_axes,): `urdf.kinematics.tool_coordinates` on the tool's axes."""
    home = chain.home_pose
    r, moved = ca.DM(home.rotation.T) @ tool[0], tool[1] - home.translation
    length = ca.sqrt(r[0, 0] ** 2 + r[0, 1] ** 2)
    angles = (ca.atan2(-r[1, 2], r[2, 2]), ca.atan2(r[0, 2], length), ca.atan2(-r[0, 1], r[0, 0]))
    return ca.vertcat(*(moved[a] if a < 3 else angles[a - 3] for a in chain.tool_axes))


def missed(robot: BuiltRobot, asked: frozenset[str], tool: Placement, desired: Placement, further: Placement) -> ca.SX:
    """(n_tool_axes,): by how much a tool pose misses what is asked for; `HybridMethod.command` says it of batches.

    further: (rotation, translation) by which the prediction is ahead of the model's: turned in the target's frame,
    moved in the instrument's. A tool that turns every way misses a rotation by a vector, others in coordinates: both
    are zero together.
    """
    chain, alone = robot.chain, measured(robot, tool)
    here = (alone[0] @ further[0], alone[1] + further[1])
    wanted = filled(asked, desired, here)
    aim = in_base(robot, filled(asked, (wanted[0] @ further[0].T, wanted[1] - further[1]), alone))
    apart = coordinates(chain, tool) - coordinates(chain, aim)
    moves = [apart[k] for k, axis in enumerate(chain.tool_axes) if axis < 3]
    turns = [wrap(apart[k]) for k, axis in enumerate(chain.tool_axes) if axis >= 3]
    if len(turns) == 3:  # 2 tan(angle / 2) about the axis: no second root at half a turn
        relative = aim[0].T @ tool[0]
        turns = [4 * ca.inv_skew(relative) / (1 + ca.trace(relative))]
    return ca.vertcat(*moves, *turns)


def filled(asked: frozenset[str], desired: Placement, predicted: Placement) -> Placement:
    """`Goal.filled`."""
    wanted, rotation = desired[0], predicted[0]
    if all_turns(asked):
        rotation = wanted
    elif "tilt" in asked:  # by the smallest turn from one vertical to the other, both seen from the target
        seen, up = rotation[2, :].T, wanted[2, :].T
        turn = ca.skew(ca.cross(up, seen))
        rotation = rotation @ (ca.SX.eye(3) + turn + turn @ turn / (1 + ca.dot(up, seen)))
    elif "yaw" in asked:
        (a, b), (c, d) = ((r[0, 0], r[1, 0]) for r in (wanted, rotation))
        length = ca.sqrt((a**2 + b**2) * (c**2 + d**2))
        cosine, sine = (a * c + b * d) / length, (b * c - a * d) / length
        about_z = ca.vertcat(ca.horzcat(cosine, -sine, 0), ca.horzcat(sine, cosine, 0), ca.SX([[0, 0, 1]]))
        rotation = about_z @ rotation
    return rotation, desired[1] if "position" in asked else predicted[1]


def wrap(angle: ca.SX) -> ca.SX:
    return ca.atan2(ca.sin(angle), ca.cos(angle))


def in_base(robot: BuiltRobot, pose: Placement) -> Placement:
    """The tool pose W^-1 * pose * T^-1 of a pose in the measurement frame."""
    return after(after(constant(robot.instrument.inverse()), pose), constant(robot.target.inverse()))


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """(3, 3) of a quaternion (4,) x, y, z, w of any length."""
    x, y, z, w = ca.vertsplit(quaternion / ca.norm_2(quaternion))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        ca.horzcat(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        ca.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
