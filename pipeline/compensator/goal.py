"""The part of a desired pose that counts, met on the tool's axes.

A robot with fewer axes than six cannot have every pose, and instruments do not measure all of one. The parts that
nobody asks for are as the method predicts them where the robot goes: the desired pose is filled with the prediction.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property

import casadi as ca
import numpy as np

from kincal.identification.channels import all_turns, parts
from kincal.identification.error_model import BuiltRobot
from kincal.identification.measurements import quaternions
from kincal.identification.symbolic_chain import Placement, after, wrapped
from kincal.pipeline.compensator.functions import call, function
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.kinematics import inverse, tool_coordinates, tool_pose, tool_rates, tree
from kincal.urdf.rigid_motion import Motion

WHOLE = ("orientation", "position")  # channels of a desired pose that is known altogether
_SEEN = 1e-2  # share of a tool coordinate's change that must show in the parts asked for, to decide it


@dataclass(frozen=True)
class Goal:
    """Which of `tilt`, `yaw` and `position` of desired poses a robot is asked for.

    A desired pose in the measurement frame is met where the tool coordinates on the tool's axes are those of the
    desired tool pose W^-1 * desired * T^-1; the other coordinates follow the mechanism. A direction that the parts
    asked for do not decide is as the desired pose has it.
    """

    robot: BuiltRobot
    asked: frozenset[str]

    @staticmethod
    def of(robot: BuiltRobot, channels: Iterable[str]) -> Goal:
        """channels: the parts of desired poses that are known.

        A tool that can turn (or move) every way is asked for all of the orientation (position), known or not: there is
        nothing to fill it with; one that can't at all is not asked for it.
        """
        asked = parts(channels)
        for group, axes in ((parts(["orientation"]), (3, 4, 5)), (parts(["position"]), (0, 1, 2))):
            free = set(axes) & set(robot.chain.tool_axes)
            asked = asked - group if not free else asked | group if len(free) == 3 else asked
        return Goal(robot, asked)

    def seen_by(self, channels: Iterable[str]) -> Goal:
        """Asks for nothing that `channels` do not measure."""
        return Goal(self.robot, self.asked & parts(channels))

    @property
    def whole(self) -> bool:
        """Whether nothing needs to be filled in: a tool that turns only may have any position."""
        return self.asked >= parts(WHOLE if min(self.robot.chain.tool_axes) < 3 else ["orientation"])

    @property
    def decided(self) -> bool:
        """Whether the parts asked for decide all of the tool's axes, at home."""
        return self.whole or not len(self._undecided[1])

    def tool(self, desired: Motion, predicted: Motion) -> Motion:
        """Tool poses in the base frame (n) of desired poses that are filled with predicted ones."""
        robot = self.robot
        return robot.instrument.inverse() @ filled(self.asked, desired, predicted) @ robot.target.inverse()

    def rates(self, desired: Motion, q: np.ndarray) -> np.ndarray:
        """(n, 6, n_tool_axes): how `tool` moves with the robot at closed configurations q: (n, n_joints).

        Coordinates of the desired tool poses, filled with the model's own prediction, by the tool coordinates on the
        tool's axes.
        """
        chain = self.robot.chain
        u = tool_coordinates(chain, tool_pose(chain, tree(chain, q)))
        by_coordinates = call(self._filled_coordinates, u, desired.translation, quaternions(desired.rotation))[0]
        return by_coordinates.reshape(-1, 6, 6).swapaxes(1, 2) @ tool_rates(chain, q)

    def missed(self, tool: Placement, desired: Placement, further: Placement) -> ca.SX:
        """(n_tool_axes,): by how much a tool pose misses the parts asked for.

        further: (rotation, translation) by which the prediction is ahead of the model's: turned in the target's frame,
        moved in the instrument's. A tool that turns every way misses a rotation by a vector, others in coordinates:
        both are zero together.
        """
        alone = measured(self.robot, tool)
        here = (alone[0] @ further[0], alone[1] + further[1])
        wanted = _filled(self.asked, desired, here)
        aim = _filled(self.asked, (wanted[0] @ further[0].T, wanted[1] - further[1]), alone)
        error = self._apart(tool, in_base(self.robot, aim))
        if self.decided:
            return error
        seen, left = self._undecided
        return ca.vertcat(ca.DM(seen) @ error, ca.DM(left) @ self._apart(tool, in_base(self.robot, desired)))

    def _apart(self, tool: Placement, aim: Placement) -> ca.SX:
        axes = self.robot.chain.tool_axes
        apart = coordinates(self.robot.chain, tool) - coordinates(self.robot.chain, aim)
        moves = [apart[k] for k, axis in enumerate(axes) if axis < 3]
        turns = [wrapped(apart[k]) for k, axis in enumerate(axes) if axis >= 3]
        if len(turns) == 3:  # 2 tan(angle / 2) about the axis: no second root at half a turn
            relative = aim[0].T @ tool[0]
            turns = [4 * ca.inv_skew(relative) / (1 + ca.trace(relative))]
        return ca.vertcat(*moves, *turns)

    @cached_property
    def _undecided(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (r, n_tool_axes) in which an error shows at home, and (n_tool_axes - r, n_tool_axes) left open."""
        robot, axes = self.robot, list(self.robot.chain.tool_axes)
        home = inverse(robot.chain, np.zeros((1, 6)))
        shows = np.eye(len(axes)) - self.rates(robot.measured(home.pose), home.q)[0, axes]
        left, sizes, right = np.linalg.svd(shows)
        rank = int(np.sum(sizes > _SEEN))
        return left[:, :rank].T, right[rank:]

    @cached_property
    def _filled_coordinates(self) -> ca.Function:
        """Predicted tool coordinates (6,), desired position, quaternion -> (6, 6): filled ones by predicted ones."""
        chain, u = self.robot.chain, ca.SX.sym("u", 6)
        position, quaternion = ca.SX.sym("position", 3), ca.SX.sym("quaternion", 4)
        predicted = measured(self.robot, _tool_at(chain, u))
        aim = in_base(self.robot, _filled(self.asked, (rotation_of(quaternion), position), predicted))
        jacobian = ca.jacobian(coordinates(chain, aim, range(6)), u)
        return function("filled_coordinates", [u, position, quaternion], [jacobian])


def filled(asked: frozenset[str], desired: Motion, predicted: Motion) -> Motion:
    """Predicted poses (n) with the parts asked for of the desired ones put in; for tilt alone by the smallest turn."""
    given = (desired.rotation, desired.translation, predicted.rotation, predicted.translation)
    n = max(len(part) for part in given)
    inputs = [np.broadcast_to(part, (n, *part.shape[1:])) for part in given]
    rotation, translation = call(_filling(asked), *(i.swapaxes(1, -1) if i.ndim == 3 else i for i in inputs))
    return Motion(rotation.reshape(n, 3, 3).swapaxes(1, 2), translation)


@cache
def _filling(asked: frozenset[str]) -> ca.Function:
    desired, predicted = symbols(), symbols()
    return function("filled", [*desired, *predicted], _filled(asked, desired, predicted))


def _filled(asked: frozenset[str], desired: Placement, predicted: Placement) -> Placement:
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


def symbols() -> Placement:
    """An unknown pose."""
    return ca.SX.sym("rotation", 3, 3), ca.SX.sym("translation", 3)


def constant(motion: Motion) -> Placement:
    """A known pose."""
    return ca.DM(motion.rotation), ca.DM(motion.translation)


def measured(robot: BuiltRobot, tool: Placement) -> Placement:
    """W * tool pose * T."""
    return after(after(constant(robot.instrument), tool), constant(robot.target))


def in_base(robot: BuiltRobot, pose: Placement) -> Placement:
    """The tool pose W^-1 * pose * T^-1 of a pose in the measurement frame."""
    return after(after(constant(robot.instrument.inverse()), pose), constant(robot.target.inverse()))


def coordinates(chain: ClosedChain, tool: Placement, axes: Iterable[int] | None = None) -> ca.SX:
    """`urdf.kinematics.tool_coordinates` on some axes; None: those of the tool."""
    home = chain.home_pose
    r, moved = ca.DM(home.rotation.T) @ tool[0], tool[1] - home.translation
    length = ca.sqrt(r[0, 0] ** 2 + r[0, 1] ** 2)
    angles = (ca.atan2(-r[1, 2], r[2, 2]), ca.atan2(r[0, 2], length), ca.atan2(-r[0, 1], r[0, 0]))
    return ca.vertcat(*(moved[a] if a < 3 else angles[a - 3] for a in (chain.tool_axes if axes is None else axes)))


def _tool_at(chain: ClosedChain, u: ca.SX) -> Placement:
    """`urdf.kinematics.pose_at`."""
    home = chain.home_pose
    rotation = ca.DM(home.rotation)
    for k in range(3):
        c, s = ca.cos(u[3 + k]), ca.sin(u[3 + k])
        i, j = (k + 1) % 3, (k + 2) % 3
        turn = ca.SX.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        rotation = rotation @ turn
    return rotation, ca.DM(home.translation) + u[:3]


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """(3, 3) of a quaternion (4,) x, y, z, w of any length."""
    x, y, z, w = ca.vertsplit(quaternion / ca.norm_2(quaternion))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        ca.horzcat(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        ca.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
