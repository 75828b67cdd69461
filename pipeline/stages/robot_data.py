"""What several stages begin with, one argument each: the robot as drawn, and the poses measured on it.

Each is made of other stages' results and of settings, by the names of its fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from kincal.pipeline.results import Bundle, Filtered, Identified, Model
from kincal.urdf.description import Actuator, RobotDescription, Sensor, Split, Tolerance

if TYPE_CHECKING:
    import numpy as np

    from kincal.identification.error_model import ErrorModel
    from kincal.identification.measurements import Measurements
    from kincal.urdf.kinematics import Closure


@dataclass(frozen=True)
class DrawnRobot(Bundle):
    """The robot as drawn, and how far it may be from its drawing."""

    model: Model
    tolerance: Tolerance
    actuator: dict[str, Actuator]

    @classmethod
    def of(cls, model: Model, description: RobotDescription) -> DrawnRobot:
        return cls(model, description.tolerance, description.actuator)

    @cached_property
    def errors(self) -> ErrorModel:
        from kincal.identification.error_model import ErrorModel

        return ErrorModel.of(self.model.chain(), self.actuator, self.tolerance)

    def closed(self, u: np.ndarray, name: str) -> tuple[Closure, np.ndarray]:
        """With its tool at u (n, 6), and the readings there. Raises InputError that begins with `name` and the row."""
        from kincal.urdf.kinematics import inverse

        closure = inverse(self.errors.chain, u).require(lambda row: f"{name} {row}")
        return closure, self.errors.actuators.readings(closure.q[:, self.errors.chain.actuated])


@dataclass(frozen=True)
class Poses(DrawnRobot):
    """The measured poses with their weights, or as many of them as [split] asks for."""

    filtered: Filtered
    sensor: Sensor
    split: Split
    seed: int

    @classmethod
    def measured_on(cls, model: Model, filtered: Filtered, description: RobotDescription) -> Poses:
        d = description
        return cls(model, d.tolerance, d.actuator, filtered, d.sensor, d.split, d.seed)

    @cached_property
    def measurements(self) -> Measurements:
        from kincal.identification.measurements import to_measurements
        from kincal.identification.poses import chosen

        poses = to_measurements(self.filtered.table, self.errors.chain.actuated_names, self.sensor)
        few = self.split.poses
        return poses if few is None else poses[chosen(len(poses), few, self.seed)]

    def fitted(self, identified: Identified) -> Measurements:
        """Those that the robot was identified from."""
        import numpy as np

        kept = ~np.isin(self.measurements.pose, identified.left_out)
        return self.measurements if kept.all() else self.measurements[kept]
