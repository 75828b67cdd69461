"""The six methods as one thing: readings to poses in the measurement frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.learning.correction import Correction
from kincal.learning.network import Network
from kincal.pipeline.learned import Corrected, Learned
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.results import Fit
from kincal.urdf.kinematics import Closure
from kincal.urdf.rigid_motion import Motion, exp, log

METHODS = ("nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid")  # in the table's order


class Method(Protocol):
    def predict(self, readings: np.ndarray) -> Motion:
        """Poses (n) in the measurement frame at readings (n, n_actuated)."""
        ...


@dataclass(frozen=True)
class ModelMethod:
    """A model of the robot: W * forward(q) * T."""

    robot: BuiltRobot
    name: str = "geometric"

    def close(self, readings: np.ndarray) -> Closure:
        return self.robot.close(readings)

    def predict(self, readings: np.ndarray) -> Motion:
        closure = self.close(readings).require(lambda row: f"row {row + 1}")
        return self.robot.measured(closure.pose)


@dataclass(frozen=True)
class HybridMethod:
    """From the identified model towards the refined one with the actuators' correction, W * forward(q + delta(q)) * T.

    All the way where the correction is believed; not at all, to the last bit, where it is not.
    """

    geometric: ModelMethod
    refined: BuiltRobot
    correction: Correction

    def close(self, readings: np.ndarray) -> Closure:
        """The refined model's configurations, with the correction."""
        return self.refined.close(readings, shift=self.correction(readings))

    def predict(self, readings: np.ndarray) -> Motion:
        alone, share = self.geometric.predict(readings), self.correction.share(readings)
        rows = np.flatnonzero(share > 0)
        if not len(rows):
            return alone
        closure = self.close(readings[rows])
        rows, poses = rows[closure.closed], closure.pose[closure.closed]  # where it can't be closed it says nothing
        corrected, model, part = self.refined.measured(poses), alone[rows], share[rows, None]
        turned = model.rotation @ exp(part * log(model.rotation.swapaxes(1, 2) @ corrected.rotation))
        moved = model.translation + part * (corrected.translation - model.translation)
        rotation, translation = alone.rotation.copy(), alone.translation.copy()
        rotation[rows], translation[rows] = turned, moved
        return Motion(rotation, translation)


@dataclass(frozen=True)
class NetworkMethod:
    """The paper's networks: readings to the tool's pose in a chart, then through the registered frames."""

    network: Network
    chart: Chart

    def predict(self, readings: np.ndarray) -> Motion:
        return self.chart.pose(self.network(readings), readings)


def build(
    model: ErrorModel, fit: Fit, learned: Learned | None, corrected: Corrected | None, channels: tuple[str, ...]
) -> Mapping[str, Method]:
    """{name: method} of one fit, in the table's order; without the learned ones where they are not given."""
    nominal, identified = model.robot(fit.registered), model.robot(fit.identified)
    geometric = ModelMethod(identified)
    methods: dict[str, Method] = {"nominal": ModelMethod(nominal, "nominal"), "geometric": geometric}
    if learned is not None:
        as_drawn, as_built = Chart(nominal, channels), Chart(identified, channels)
        methods["network"] = NetworkMethod(learned.network, as_drawn)
        methods["transfer"] = NetworkMethod(learned.transfer, as_drawn)
        methods["transfer_identified"] = NetworkMethod(learned.transfer_identified, as_built)
    if corrected is not None:
        methods["hybrid"] = HybridMethod(geometric, model.robot(corrected.refined), corrected.correction)
    return methods


def uncalibrated(model: ErrorModel) -> Method:
    """The nominal robot with W = T = 1."""
    return ModelMethod(model.robot(np.zeros(len(model.parameters))), "nominal")
