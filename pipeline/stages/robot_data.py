"""What several stages begin with: the error model of the robot as drawn, the poses in use, closed configurations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kincal.pipeline.results import Filtered, Model
from kincal.urdf.description import Actuator, Sensor, Split, Tolerance

if TYPE_CHECKING:
    import numpy as np

    from kincal.identification.error_model import ErrorModel
    from kincal.identification.measurements import Measurements
    from kincal.urdf.kinematics import Closure


def error_model(model: Model, tolerance: Tolerance, actuator: dict[str, Actuator]) -> ErrorModel:
    """Of the robot as drawn."""
    from kincal.identification.error_model import ErrorModel

    return ErrorModel.of(model.chain(), actuator, tolerance)


def used_poses(filtered: Filtered, errors: ErrorModel, sensor: Sensor, split: Split, seed: int) -> Measurements:
    """The measured poses, or as many of them as [split] asks for."""
    from kincal.identification.measurements import to_measurements
    from kincal.identification.poses import chosen

    poses = to_measurements(filtered.table, errors.chain.actuated_names, sensor)
    return poses if split.poses is None else poses[chosen(len(poses), split.poses, seed)]


def closed(errors: ErrorModel, u: np.ndarray, what: str) -> tuple[Closure, np.ndarray]:
    """The robot as drawn with its tool at u (n, 6), and the readings there. Raises InputError that says `what` row."""
    from kincal.urdf.kinematics import inverse

    closure = inverse(errors.chain, u).require(lambda row: f"{what} {row}")
    return closure, errors.actuators.readings(closure.q[:, errors.chain.actuated])
