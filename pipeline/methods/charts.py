"""What the paper's networks put out: the tool's pose in a chart that is regular at home, of what was measured.

Each channel knows its coordinates. They are of the tool in the base frame, the registered W and T taken off. What was
not measured is not learned; where a pose needs it, the model fills it in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kincal.identification.channels import all_turns, merged
from kincal.identification.channels.channel import Channel
from kincal.identification.error_model import BuiltRobot
from kincal.identification.measurements import Measurements
from kincal.urdf.kinematics import pose_at
from kincal.urdf.rigid_motion import Motion


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
        return sum(c.n_out for c in self._learned)

    @property
    def _learned(self) -> tuple[Channel, ...]:
        return tuple(c for c in merged(self.channels) if c.n_out)

    def of_tool(self, tool: Motion) -> np.ndarray:
        """y of tool poses in the base frame (n): the source task."""
        return np.concatenate([c.outputs(self.robot, tool) for c in self._learned], axis=1)

    def of_measured(self, measured: Measurements, pose: Motion) -> np.ndarray:
        """y of measured poses (n), given as `pose` in the measurement frame: the target task."""
        if self.full:
            return self.of_tool(self.robot.instrument.inverse() @ pose @ self.robot.target.inverse())
        tool, outputs = self.robot.close(measured.readings).pose, []
        for channel in self._learned:
            y = channel.measured_outputs(self.robot, measured.values[channel.name], tool.rotation)
            tool = channel.put(self.robot, y, tool)
            outputs.append(y)
        return np.concatenate(outputs, axis=1)

    def pose(self, y: np.ndarray, readings: np.ndarray) -> Motion:
        """Poses (n) in the measurement frame of outputs y: (n, n_out)."""
        return self.posed(y, None if self.full else self.robot.close(readings).pose.rotation)

    def posed(self, y: np.ndarray, modelled: np.ndarray | None) -> Motion:
        """The same; modelled: the tool's orientations (n, 3, 3) by the model, needed where not all was measured."""
        tool = pose_at(self.robot.chain, np.zeros((len(y), 6)))
        if not self.full:
            assert modelled is not None
            tool = Motion(modelled, tool.translation)
        for channel, columns in self._columns():
            tool = channel.put(self.robot, y[:, columns], tool)
        return self.robot.measured(tool)

    def _columns(self) -> Iterator[tuple[Channel, slice]]:
        first = 0
        for channel in self._learned:
            yield channel, slice(first, first + channel.n_out)
            first += channel.n_out
