"""What the paper's networks put out: the tool's pose in a chart that is regular at home, of what was measured.

Orientation: intrinsic XYZ angles of home orientation^T * orientation of the tool in the base frame, the registered W
and T taken off; position: from home along the base axes. Tilt alone: two coordinates of the vertical, turned so
that home's is (0, 0, 1). What was not measured is not learned; where a pose needs it, the model fills it in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.channels import all_turns
from kincal.identification.error_model import BuiltRobot
from kincal.identification.measurements import Measurements
from kincal.identification.registration import vertical_in_target
from kincal.urdf.kinematics import pose_at, tool_coordinates
from kincal.urdf.rigid_motion import Motion

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Chart:
    """Between network outputs y (n, n_out) and poses, for one registered robot and its channels."""

    robot: BuiltRobot
    channels: tuple[str, ...]

    @property
    def full(self) -> bool:
        """Whether all of the orientation was measured."""
        return all_turns(self.channels)

    @property
    def tilt(self) -> bool:
        return "tilt" in self.channels and not self.full

    @property
    def moved(self) -> bool:
        return "position" in self.channels

    @property
    def n_out(self) -> int:
        return 3 * self.full + 2 * self.tilt + 3 * self.moved

    def of_tool(self, tool: Motion) -> np.ndarray:
        """y of tool poses in the base frame (n): the source task."""
        u = tool_coordinates(self.robot.chain, tool)
        parts = [u[:, 3:]] if self.full else []
        if self.tilt:
            parts.append(self._vertical(tool.rotation.swapaxes(1, 2) @ self._up))
        return np.concatenate([*parts, *([u[:, :3]] if self.moved else [])], axis=1)

    def of_measured(self, measured: Measurements, pose: Motion) -> np.ndarray:
        """y of measured poses (n), given as `pose` in the measurement frame: the target task."""
        tool = self.robot.instrument.inverse() @ pose @ self.robot.target.inverse()
        if self.full:
            return self.of_tool(tool)
        modelled = self.robot.close(measured.readings).pose
        parts = []
        rotation = modelled.rotation
        if self.tilt:
            parts.append(self._vertical(vertical_in_target(measured) @ self.robot.target.rotation.T))
            rotation = self._tilted(rotation, parts[0])
        if self.moved:  # the target's lever arm, turned as the model (and the tilt) has it
            at = self.robot.instrument.inverse() @ Motion(np.eye(3), pose.translation)
            arm = rotation @ self.robot.target.translation
            parts.append(at.translation - arm - self.robot.chain.home_pose.translation)
        return np.concatenate(parts, axis=1)

    def pose(self, y: np.ndarray, readings: np.ndarray) -> Motion:
        """Poses (n) in the measurement frame of outputs y: (n, n_out)."""
        return self.posed(y, None if self.full else self.robot.close(readings).pose.rotation)

    def posed(self, y: np.ndarray, modelled: np.ndarray | None) -> Motion:
        """The same; modelled: the tool's orientations (n, 3, 3) by the model, needed where not all was measured."""
        u = np.zeros((len(y), 6))
        if self.full:
            u[:, 3:] = y[:, :3]
        if self.moved:
            u[:, :3] = y[:, -3:]
        tool = pose_at(self.robot.chain, u)
        if not self.full:
            assert modelled is not None
            tool = Motion(self._tilted(modelled, y[:, :2]) if self.tilt else modelled, tool.translation)
        return self.robot.measured(tool)

    @property
    def _up(self) -> np.ndarray:
        """The vertical in the base frame."""
        return self.robot.instrument.rotation.T @ _UP

    @property
    def _home(self) -> np.ndarray:
        """The turn that brings the vertical seen from the tool at home to (0, 0, 1)."""
        vertical = self.robot.chain.home_pose.rotation.T @ self._up
        return Rotation.align_vectors(_UP[None], vertical[None])[0].as_matrix()

    def _vertical(self, seen: np.ndarray) -> np.ndarray:
        return (seen @ self._home.T)[:, :2]

    def _tilted(self, rotation: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The orientations nearest to `rotation` (n, 3, 3) that see the vertical where y says."""
        upright = np.sqrt(np.maximum(1 - np.sum(y**2, axis=1, keepdims=True), 0.0))
        wanted = np.concatenate([y, upright], axis=1) @ self._home
        seen = rotation.swapaxes(1, 2) @ self._up
        axis = np.cross(wanted, seen)
        sine = np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.arctan2(sine, np.sum(wanted * seen, axis=1, keepdims=True))
        turn = Rotation.from_rotvec(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)).as_matrix()
        return rotation @ turn
