"""A shipped robot as the stages see it: closed chain, error model, and virtual measurements."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identification.error_model import ErrorModel
from identification.measurements import Measurements, to_measurements, to_table
from identification.poses import planned
from pipeline.stages import model
from pipeline.virtual_robot import VirtualRobot, default_channels, draw, measure
from urdf.description import load_robot
from urdf.kinematics import inverse


def measured_robot(name: str, poses: int) -> tuple[ErrorModel, Measurements]:
    description = load_robot(name, [f"plan.poses={poses}"]).description
    chain = model(description.mechanism, Path(description.urdf)).chain()
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    u = planned(description.workspace, chain.tool_axes, description.plan, seed=0)
    readings = errors.actuators.readings(inverse(chain, u).q[:, chain.actuated])
    pose = VirtualRobot.of(errors, draw(errors, description.measure.errors, seed=0)).pose(readings)
    columns = measure(pose, default_channels(chain.tool_axes), description.sensor, seed=0)
    table = to_table(chain.actuated_names, readings, columns)
    return errors, to_measurements(table, chain.actuated_names, description.sensor)


def grid(errors: ErrorModel, side: int) -> np.ndarray:
    """Tool coordinates on the paper's uniform grid of the source task, side^3 poses."""
    from urdf.workspace import grid as uniform

    workspace = load_robot("ups3_s").description.workspace
    return uniform(workspace, errors.chain.tool_axes, [side] * 3)
