"""Desired poses, and the commands that reach them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.channels import parts
from kincal.identification.measurement_table import canonical_table
from kincal.identification.measurements import to_measurements
from kincal.pipeline.compensator.commands import Commands, commands
from kincal.pipeline.compensator.goal import Goal
from kincal.pipeline.compensator.solvers import Solvers
from kincal.pipeline.methods.calibrated import CalibratedRobot
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import AXES


def commands_of(
    calibrated: CalibratedRobot, solvers: Solvers, method: str, raw: pd.DataFrame, source: Path | str
) -> Commands:
    """The actuators' readings that reach the poses of a table (a measurement table without joints). Raises InputError.

    Whether a pose can be reached is a matter of each row; see `Commands`.
    """
    model, description = calibrated.model, calibrated.description
    settings = description.measure.of_columns(()).of_other_table()
    table = canonical_table(raw, (), settings, source)
    desired, known, numbers = _desired(table, calibrated, source)
    solver = solvers.of(calibrated.methods[method], known)
    return commands(solver, desired, model.chain, model.actuators, description.workspace, numbers)


def _desired(
    table: pd.DataFrame, calibrated: CalibratedRobot, source: Path | str
) -> tuple[Motion, tuple[str, ...], np.ndarray]:
    """Desired poses, the parts of them that are known, and their numbers.

    Known is what the file says of what was measured. Where that leaves the tool something to choose, the rest of what
    was measured counts, too: there and in all else the file does not say, the poses are as at home.
    """
    wanted = to_measurements(table, (), calibrated.description.sensor)
    model, identified = calibrated.model, calibrated.identification
    axes = model.chain.tool_axes
    if any(a < 3 for a in axes) and "position" not in wanted.values:
        raise InputError(f"{source}: the tool moves along {[AXES[a] for a in axes if a < 3]}: x, y, z are needed")
    if any(a >= 3 for a in axes) and "orientation" not in wanted.values and "tilt" not in wanted.values:
        raise InputError(f"{source}: the tool turns: qx, qy, qz, qw or roll, pitch (and yaw) are needed")
    robot = model.robot(identified.change)
    home = robot.measured(model.chain.home_pose)
    pose = wanted.as_poses()
    if "orientation" not in wanted.values and "tilt" not in wanted.values:
        pose = Motion(np.broadcast_to(home.rotation, pose.rotation.shape), pose.translation)
    elif "orientation" not in wanted.values and "yaw" not in wanted.values:
        yaw = np.full(len(wanted), np.arctan2(home.rotation[1, 0], home.rotation[0, 0]))
        pose = wanted.replaced(yaw=yaw).as_poses()
    if "position" not in wanted.values:
        pose = Motion(pose.rotation, np.broadcast_to(home.translation, pose.translation.shape))
    measured = identified.channels
    known = tuple(sorted(parts(wanted.channels) & parts(measured)))
    return pose, known if Goal.of(robot, known).decided else measured, wanted.pose
