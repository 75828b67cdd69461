"""Where a virtual robot is scored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kincal.pipeline.results import Truth
from kincal.pipeline.stages.robot_data import DrawnRobot

if TYPE_CHECKING:
    from kincal.identification.measurements import Measurements
    from kincal.urdf.rigid_motion import Motion


def fresh_poses(robot: DrawnRobot, truth: Truth, n: int, seed: int) -> tuple[Measurements, Motion]:
    """Random poses of the workspace, and where the virtual robot really goes there, without noise: warm, one by one."""
    import numpy as np

    from kincal.identification.measurements import Measurements
    from kincal.pipeline.virtual.robot import VirtualRobot
    from kincal.urdf.workspace import sample

    u = sample(robot.model.mechanism.workspace, robot.errors.chain.tool_axes, n, [seed, 5])
    _, readings = robot.closed(u, "evaluate: fresh pose")
    virtual = VirtualRobot.of(robot.errors, truth)
    return Measurements(np.arange(n), readings), virtual.pose(readings, virtual.after_campaign(readings))
