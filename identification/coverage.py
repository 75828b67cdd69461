"""Whether the measured poses determine the robot all over its workspace, or only where they are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kincal.identification.channels import scored
from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate
from kincal.identification.expected import feasible
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements
from kincal.identification.predicted_accuracy import mean_length
from kincal.urdf.description import Workspace
from kincal.urdf.workspace import sample

_POSES = 100  # of the workspace
_WORSE = 3.0  # times the error at the measured poses; where these fill the workspace, the ratio is 0.8 to 1.2
NOT_COVERED = "do not cover [workspace]"


def coverage_finding(
    model: ErrorModel, workspace: Workspace, measured: Measurements, estimate: Estimate, seed: int
) -> str | None:
    """A sentence where the expected error over the workspace is far larger than at the measured poses; else None.

    Both follow from the covariance of the estimate: noise and tolerances, not what geometry can't explain.
    """
    sites, _ = feasible(model, workspace, sample(workspace, model.chain.tool_axes, _POSES, [seed, 13]))
    if not len(sites):
        return None
    everywhere = _expected(model, measured.channels, estimate, sites.readings, sites.q)
    here = _expected(model, measured.channels, estimate, measured.readings, estimate.q)
    worse = [unit for unit in here if everywhere.get(unit, 0.0) > _WORSE * here[unit]]
    if not worse:
        return None
    return (
        f"the {len(measured)} poses {NOT_COVERED}: there the expected mean error of the geometry is "
        f"{_size(everywhere, worse)}, at the measured poses {_size(here, worse)}. Measure more poses all over "
        "[workspace], or make it smaller"
    )


def _expected(
    model: ErrorModel, channels: tuple[str, ...], estimate: Estimate, readings: np.ndarray, q: np.ndarray
) -> Mapping[str, float]:
    """Mean errors by unit [rad], [m], over the poses at `readings` (n, n_actuated) whose loops close."""
    robot = model.robot(estimate.p)
    closure = robot.close(readings, q)
    rows = closure.closed
    if not rows.any():
        return {}
    jacobian = model.pose_jacobian(estimate.p, readings[rows], closure.q[rows])
    rotation = robot.measured(closure.pose).rotation[rows]
    errors = {}
    for unit, channel in scored(channels).items():
        change = channel.change(jacobian, rotation)
        errors[unit] = float(np.mean(mean_length(change @ estimate.covariance @ change.swapaxes(1, 2))))
    return errors


def _size(errors: Mapping[str, float], units: list[str]) -> str:
    return " and ".join(f"{HUMAN[unit][1] * errors[unit]:.2g} {HUMAN[unit][0]}" for unit in units)
