"""Where a virtual robot is scored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kincal.pipeline.results import Model, Truth
from kincal.pipeline.stages.robot_data import closed

if TYPE_CHECKING:
    from kincal.identification.error_model import ErrorModel
    from kincal.identification.measurements import Measurements
    from kincal.urdf.rigid_motion import Motion


def fresh_poses(model: Model, errors: ErrorModel, truth: Truth, n: int, seed: int) -> tuple[Measurements, Motion]:
    """Random poses of the workspace, and where the virtual robot really goes there, without noise: warm, one by one."""
    import numpy as np

    from kincal.identification.measurements import Measurements
    from kincal.pipeline.virtual.robot import VirtualRobot
    from kincal.urdf.workspace import sample

    u = sample(model.mechanism.workspace, errors.chain.tool_axes, n, [seed, 5])
    _, readings = closed(errors, u, "evaluate: fresh pose")
    robot = VirtualRobot.of(errors, truth)
    return Measurements(np.arange(n), readings), robot.pose(readings, robot.after_campaign(readings))
