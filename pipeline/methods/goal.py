"""What a desired pose asks of a robot: the parts of it that count, met on the tool's axes.

A robot with fewer axes than six can't have every pose, and instruments don't see all of one. What is not asked for is
as the robot itself has it where it goes: the desired pose filled with the prediction there, and solved again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from kincal.identification.accuracy import gravity_error
from kincal.identification.channels import all_turns, parts
from kincal.identification.error_model import BuiltRobot
from kincal.urdf.kinematics import Closure, inverse, tool_coordinates, tool_pose, tool_rates, tree
from kincal.urdf.rigid_motion import Motion, exp, skew, wrap, xyz_rates, zyx_angles

WHOLE = ("orientation", "position")  # channels of a desired pose that is known altogether
_ITERATIONS = 20
_SETTLED = 1e-10  # of a tool coordinate [m, rad]: inverse kinematics is ten times as good
_SEEN = 1e-2  # share of a tool coordinate's change that what is asked for must show, to decide it


@dataclass(frozen=True)
class Goal:
    """Desired poses (n) in the measurement frame, and which of `tilt`, `yaw` and `position` of them is asked for.

    Met where the tool coordinates on the tool's axes are those of the desired tool pose W^-1 desired T^-1; the other
    coordinates follow the mechanism. What is not asked for, of the desired pose, is the prediction's.
    """

    robot: BuiltRobot
    desired: Motion
    asked: frozenset[str]

    @staticmethod
    def of(robot: BuiltRobot, desired: Motion, channels: Iterable[str]) -> Goal:
        """channels: the parts of `desired` that are known.

        A tool that can turn (or move) every way has all of the desired orientation (position), known or not: there is
        nothing to fill it with; one that can't at all is not asked for it.
        """
        asked = parts(channels)
        for group, axes in ((parts(["orientation"]), (3, 4, 5)), (parts(["position"]), (0, 1, 2))):
            free = set(axes) & set(robot.chain.tool_axes)
            asked = asked - group if not free else asked | group if len(free) == 3 else asked
        return Goal(robot, desired, asked)

    def seen_by(self, channels: Iterable[str]) -> Goal:
        """Asks for nothing else than what `channels` measure."""
        return replace(self, asked=self.asked & parts(channels))

    @property
    def whole(self) -> bool:
        """Whether nothing needs to be filled in: a tool that turns only may have any position."""
        return self.asked >= parts(WHOLE if min(self.robot.chain.tool_axes) < 3 else ["orientation"])

    def solve(self, near: Closure | None = None) -> tuple[Closure, np.ndarray]:
        """The robot's configurations that meet the goal, and which rows do: (n,). Newton in the tool coordinates.

        near: closed configurations (n) near by, where they are known.
        """
        chain, axes = self.robot.chain, list(self.robot.chain.tool_axes)
        u = self._start() if near is None or self.whole else tool_coordinates(chain, near.pose)
        closure = inverse(chain, u, None if near is None else near.q)
        if self.whole:
            return closure, closure.closed
        for _ in range(_ITERATIONS):
            step = self._step(closure)
            if np.max(np.abs(step), initial=0.0) < _SETTLED:
                break
            u[:, axes] -= step
            closure = inverse(chain, u, closure.q)
        return closure, closure.closed & (np.abs(self._step(closure)).max(axis=1) < _SETTLED)

    def coordinates(self, predicted: Motion) -> np.ndarray:
        """u: (n, 6) of `tool`."""
        return tool_coordinates(self.robot.chain, self.tool(predicted))

    def tool(self, predicted: Motion) -> Motion:
        """The tool's poses in the base frame where the desired poses are filled with predicted ones (n)."""
        return self.robot.instrument.inverse() @ self.filled(predicted) @ self.robot.target.inverse()

    def rates(self, q: np.ndarray) -> np.ndarray:
        """(n, 6, n_tool_axes): d(coordinates) / d(tool coordinates on the axes) at closed configurations q.

        How the part that is filled in moves with the robot; exact where the goal is met.
        """
        chain, w, t = self.robot.chain, self.robot.instrument, self.robot.target
        tool, moved = tool_pose(chain, tree(chain, q)), tool_rates(chain, q)
        # of an angular velocity in the base frame to the angles' rates, and back
        to_angles = xyz_rates(tool_coordinates(chain, tool)[:, 3:]) @ chain.home_pose.rotation.T
        turning = np.linalg.solve(to_angles, moved[:, 3:])
        arm = skew(tool.rotation @ t.translation)
        at_target = moved[:, :3] - arm @ turning
        if "position" in self.asked:
            at_target = np.zeros_like(at_target)
        up = w.rotation.T @ np.array([0.0, 0.0, 1.0])
        if all_turns(self.asked):
            turning = np.zeros_like(turning)
        elif "tilt" in self.asked:  # a turn about the vertical alone
            turning = np.outer(up, up) @ turning
        elif "yaw" in self.asked:
            yaw, pitch, _ = np.moveaxis(zyx_angles((w @ tool @ t).rotation), -1, 0)
            of_yaw = np.stack([np.cos(yaw) * np.tan(pitch), np.sin(yaw) * np.tan(pitch), np.ones_like(yaw)], axis=1)
            turning = turning - up[:, None] * ((of_yaw @ w.rotation)[:, None] @ turning)
        return np.concatenate([at_target + arm @ turning, to_angles @ turning], axis=1)

    def decided(self) -> bool:
        """Whether what is asked for decides all of the tool's axes, at home."""
        return bool(np.linalg.matrix_rank(self._sight(self._home().q), tol=_SEEN)[0] == len(self.robot.chain.tool_axes))

    def _start(self) -> np.ndarray:
        """Filled with the pose at home; but the desired poses as they are, where they alone say what is left open."""
        if self.whole or not self.decided():
            tool = self.robot.instrument.inverse() @ self.desired @ self.robot.target.inverse()
            return tool_coordinates(self.robot.chain, tool)
        home, n = self.robot.measured(self._home().pose)[0], len(self.desired.translation)
        everywhere = Motion(np.broadcast_to(home.rotation, (n, 3, 3)), np.broadcast_to(home.translation, (n, 3)))
        return self.coordinates(everywhere)

    def _home(self) -> Closure:
        return inverse(self.robot.chain, np.zeros((1, 6)))

    def _sight(self, q: np.ndarray) -> np.ndarray:
        """(n, n_tool_axes, n_tool_axes): how much of a change of the tool coordinates shows in what is asked for."""
        axes = list(self.robot.chain.tool_axes)
        return np.eye(len(axes)) - self.rates(q)[:, axes]

    def _step(self, closure: Closure) -> np.ndarray:
        """(n, n_tool_axes): Newton's step in the tool coordinates; 0 where the loops don't close."""
        rows, axes = np.flatnonzero(closure.closed), list(self.robot.chain.tool_axes)
        step = np.zeros((len(closure.q), len(axes)))
        here, pose = self[rows], closure.pose[rows]
        error = tool_coordinates(self.robot.chain, pose) - here.coordinates(self.robot.measured(pose))
        error[:, 3:] = wrap(error[:, 3:])
        step[rows] = (np.linalg.pinv(here._sight(closure.q[rows]), rcond=_SEEN) @ error[:, axes, None])[..., 0]
        return step

    def __getitem__(self, rows: np.ndarray) -> Goal:
        return replace(self, desired=self.desired[rows])

    def filled(self, predicted: Motion) -> Motion:
        """Predicted poses (n) with what is asked for put in; for tilt alone by the smallest turn."""
        wanted, rotation = self.desired, predicted.rotation
        if all_turns(self.asked):
            rotation = wanted.rotation
        elif "tilt" in self.asked:
            rotation = rotation @ exp(-gravity_error(wanted.rotation, rotation))
        elif "yaw" in self.asked:
            turn = zyx_angles(wanted.rotation)[:, 0] - zyx_angles(rotation)[:, 0]
            rotation = exp(turn[:, None] * np.array([0.0, 0.0, 1.0])) @ rotation
        return Motion(rotation, wanted.translation if "position" in self.asked else predicted.translation)
