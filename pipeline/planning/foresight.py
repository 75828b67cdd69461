"""What planned measurements will tell and what they never will, from the sensors alone, before anybody measures."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from kincal.identification.channels import named
from kincal.identification.estimators import foreseen
from kincal.identification.expected import expected, prior_sigma
from kincal.identification.identification import Identification
from kincal.identification.observability import Observability, observability
from kincal.identification.predicted_accuracy import PredictedAccuracy
from kincal.identification.summary import summarise
from kincal.pipeline.planning.layouts import planner
from kincal.pipeline.results import Model, PosePlan
from kincal.urdf.description import RobotDescription
from kincal.urdf.kinematics import inverse
from kincal.urdf.workspace import AXES


@dataclass(frozen=True)
class Foresight:
    """An identification without readings: only identifiability, sigmas and shares mean anything."""

    identification: Identification
    accuracy: PredictedAccuracy  # of the identified robot, geometry alone
    observability: Observability

    def lines(self) -> list[str]:
        """For people: the observability indexes, and what to expect of the identified robot."""
        o = self.observability
        indexes = ", ".join(f"O{k} {value:.3g}" for k, value in enumerate((o.o1, o.o2, o.o3, o.o4, o.o5), 1))
        a = self.accuracy
        parts = [
            f"{mean:.3g} {unit} (worst pose {worst:.3g})"
            for unit, mean, worst in (("deg", a.mean_deg, a.max_deg), ("mm", a.mean_mm, a.max_mm))
            if mean is not None
        ]
        return [f"observability: {indexes}", f"predicted mean error of geometry alone: {', '.join(parts)}"]

    def json(self) -> dict[str, Any]:
        return {"observability": asdict(self.observability), "predicted_accuracy": asdict(self.accuracy)}


def foresee(description: RobotDescription, model: Model, plan: PosePlan) -> Foresight:
    """Of the planned poses and the sensors of robot.toml, at the robot as drawn with W = T = 1."""
    chain = model.chain()
    planned = planner(description, chain)
    readings = plan.table[list(chain.actuated_names)].to_numpy(float)
    u = np.zeros((len(readings), 6))
    for axis in chain.tool_axes:
        u[:, axis] = plan.table[f"planned_{AXES[axis]}"].to_numpy(float)
    q = inverse(chain, u).q
    zero = np.zeros(len(planned.model.parameters))
    measured = expected(planned.model, zero, readings, q, planned.channels, planned.sensor)
    estimate = foreseen(planned.model, measured)
    identification = summarise(planned.model, measured, estimate, estimate)
    blocks = planned.model.jacobian(zero, measured, q)
    alone = named(planned.channels)[0].alone if len(planned.channels) == 1 else ""
    return Foresight(
        replace(identification, findings=(alone,) if alone else (), outliers=()),
        planned.probe.accuracy(blocks * prior_sigma(planned.model.parameters)),
        observability(blocks, planned.model.parameters, identification.rank),
    )
