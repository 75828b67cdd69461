"""The closed chain walked once with CasADi: joint frames, loop equations, the tool and their Jacobians; rotations.

Placements may be numbers or symbols. What stands here says the same as `urdf.kinematics` does of whole batches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from kincal.urdf.closed_chain import BASE, ClosedChain

Placement = tuple  # rotation (3, 3), translation (3,) [m]: ca.SX or ca.DM


def after(first: Placement, second: Placement) -> Placement:
    """first * second."""
    return first[0] @ second[0], first[0] @ second[1] + first[1]


def joint_frames(chain: ClosedChain, q: ca.SX, placed: Sequence[Placement]) -> dict[int, Placement]:
    """{joint: its frame in the world} at q: (n_joints,); placed: of every body, as in the chain's geometry."""
    frames: dict[int, Placement] = {BASE: (ca.SX.eye(3), ca.SX.zeros(3))}
    for j, parent in enumerate(chain.parents):
        rotation, translation = after(frames[parent], placed[j])
        axis = ca.DM(chain.axes[j])
        if chain.prismatic[j]:
            translation = translation + rotation @ axis * q[j]
        else:
            turn = ca.skew(axis)
            rotation = rotation @ (ca.DM.eye(3) + ca.sin(q[j]) * turn + (1 - ca.cos(q[j])) * (turn @ turn))
        frames[j] = (rotation, translation)
    return frames


def loop_equations(chain: ClosedChain, frames: Mapping[int, Placement], placed: Sequence[Placement]) -> ca.SX:
    """(n_equations,): 0 where the loops are closed; the same as `urdf.kinematics.loop_error`."""
    equations = [ca.SX.zeros(0, 1)]
    for loop in chain.loops:
        first, second = (after(frames[j], placed[b]) for j, b in zip(loop.joints, loop.bodies, strict=True))
        equations.append(second[1] - first[1])
        if loop.kind == "frame":
            equations.append(ca.inv_skew(first[0].T @ second[0]))
    return ca.vertcat(*equations)


def loop_rates(chain: ClosedChain, frames: Mapping[int, Placement], placed: Sequence[Placement]) -> ca.SX:
    """(n_equations, n_joints): d(loop_equations) / dq, from the joints' axes: half of what CasADi makes of it."""
    rows = [ca.SX(0, chain.n_joints)]
    for loop in chain.loops:
        first, second = (after(frames[j], placed[b]) for j, b in zip(loop.joints, loop.bodies, strict=True))
        moved = [twists(chain, frames, j, end[1]) for j, end in zip(loop.joints, (first, second), strict=True)]
        apart = moved[1] - moved[0]
        rows.append(apart[:3, :])
        if loop.kind == "frame":
            relative = first[0].T @ second[0]
            rows.append(0.5 * (ca.trace(relative) * ca.SX.eye(3) - relative) @ first[0].T @ apart[3:, :])
    return ca.vertcat(*rows)


def twists(chain: ClosedChain, frames: Mapping[int, Placement], joint: int, point: ca.SX) -> ca.SX:
    """(6, n_joints): d(velocity of `point` (3,) on `joint`, angular velocity) / dq, both in the world."""
    columns = ca.SX(6, chain.n_joints)
    for j in chain.path(joint):
        axis = frames[j][0] @ ca.DM(chain.axes[j])
        columns[:3, j] = axis if chain.prismatic[j] else ca.cross(axis, point - frames[j][1])
        if not chain.prismatic[j]:
            columns[3:, j] = axis
    return columns


def tool_rates(chain: ClosedChain, frames: Mapping[int, Placement]) -> ca.SX:
    """(6, n_joints): d(velocity, angular velocity) / dq of the tool, in the base frame; the loops left open."""
    at = after(frames[chain.tool_joint], (ca.DM(chain.tool.rotation), ca.DM(chain.tool.translation)))[1]
    columns, to_base = twists(chain, frames, chain.tool_joint, at), ca.DM(chain.base.rotation.T)
    return ca.vertcat(to_base @ columns[:3, :], to_base @ columns[3:, :])


def tool_placement(chain: ClosedChain, frames: Mapping[int, Placement]) -> Placement:
    """The tool in the base frame."""
    base = chain.base.inverse()
    tool = after((ca.DM(base.rotation), ca.DM(base.translation)), frames[chain.tool_joint])
    return after(tool, (ca.DM(chain.tool.rotation), ca.DM(chain.tool.translation)))


def rotation_vector(rotation: ca.SX) -> ca.SX:
    """log of a rotation matrix, differentiable also at the identity (Taylor there); regular below 180 degrees."""
    sine = ca.inv_skew(rotation)
    square = ca.sumsqr(sine)
    small = ca.logic_and(square < 1e-10, ca.trace(rotation) > 0)
    length = ca.sqrt(ca.if_else(small, 1.0, square))
    angle = ca.atan2(length, (ca.trace(rotation) - 1) / 2)
    # near the identity: asin(s) / s = 1 + s^2 / 6 + ..
    return sine * ca.if_else(small, 1 + square / 6, angle / length)


def rotation_matrix(vector: ca.SX) -> ca.SX:
    """exp of a rotation vector (3,) [rad], differentiable also at zero (Taylor there)."""
    square = ca.sumsqr(vector)
    small = square < 1e-10
    angle, turn = ca.sqrt(ca.if_else(small, 1.0, square)), ca.skew(vector)
    first = ca.if_else(small, 1 - square / 6, ca.sin(angle) / angle)
    second = ca.if_else(small, 0.5 - square / 24, (1 - ca.cos(angle)) / angle**2)
    return ca.SX.eye(3) + first * turn + second * (turn @ turn)


def wrapped(angle: ca.SX) -> ca.SX:
    """The same angle within half a turn."""
    return ca.atan2(ca.sin(angle), ca.cos(angle))
