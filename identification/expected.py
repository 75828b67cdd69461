"""What poses would tell before they are measured: noise-free measurements, and the information in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, Parameters
from kincal.identification.measurements import Measurements, default_channels
from kincal.identification.poses import travel_order
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Instruments, Sensor, Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import forward, inverse, tool_coordinates
from kincal.urdf.workspace import condition_numbers

FLAT = 0.1  # sigma that stands for W's and T's flat priors [m, rad]: a millionth of what one pose tells of them
_SAME = 1e-6  # tool coordinates of one pose [m, rad]


@dataclass(frozen=True)
class Sites:
    """Poses that the robot as drawn can take."""

    u: np.ndarray  # (n, 6) tool coordinates
    q: np.ndarray  # (n, n_joints) closed configurations
    readings: np.ndarray  # (n, n_actuated)

    def __len__(self) -> int:
        return len(self.u)

    def __getitem__(self, rows) -> Sites:
        return Sites(self.u[rows], self.q[rows], self.readings[rows])

    def in_travel_order(self, chain: ClosedChain) -> Sites:
        """Ordered so that the machine travels little, from home."""
        return self[travel_order(self.q[:, chain.actuated], chain.home[chain.actuated])]


def feasible(model: ErrorModel, workspace: Workspace, u: np.ndarray) -> tuple[Sites, np.ndarray]:
    """The poses among u (n, 6) that the robot can take, and which they are: (n,) bool.

    Their loops close on home's branch, from the tool's side and from the actuators'; joints are within their limits;
    the condition number is at most workspace.max_condition.
    """
    chain, axes = model.chain, list(model.chain.tool_axes)
    closure = inverse(chain, u)
    good = closure.closed & ((closure.q >= chain.lower - 1e-9) & (closure.q <= chain.upper + 1e-9)).all(axis=1)
    rows = np.flatnonzero(good)
    back = forward(chain, closure.q[rows][:, chain.actuated])
    apart = np.abs(tool_coordinates(chain, back.pose) - tool_coordinates(chain, closure.pose[rows]))[:, axes]
    regular = condition_numbers(chain, closure.q[rows]) <= workspace.max_condition
    good[rows] = back.closed & (apart.max(axis=1, initial=0.0) < _SAME) & regular
    q = closure.q[good]
    return Sites(u[good], q, model.actuators.readings(q[:, chain.actuated])), good


def all_feasible(model: ErrorModel, workspace: Workspace, u: np.ndarray, source: str) -> Sites:
    """Poses u (n, 6) that must all be feasible; else InputError that begins with `source`."""
    sites, good = feasible(model, workspace, u)
    if not good.all():
        raise InputError(f"{source}: pose {int(np.argmin(good))} can't be reached within limits, or is singular")
    return sites


def of_one_row(instruments: Instruments, tool_axes: tuple[int, ...]) -> tuple[tuple[str, ...], Sensor]:
    """What is measured, and the sigmas of a table's row.

    Where tilt and yaw come as streams, a row is the mean of a pose's samples.
    """
    channels, sensor = instruments.channels or default_channels(tool_axes), instruments.sensor
    stream = instruments.stream
    if stream is None or "tilt" not in channels:
        return channels, sensor
    samples = max(1.0, stream.rate_hz * stream.seconds * (1 - stream.dropouts) * (1 - stream.outliers))
    tilt, yaw = (float(np.rad2deg(sensor.sigma(channel)) / np.sqrt(samples)) for channel in ("tilt", "yaw"))
    return channels, sensor.model_copy(update={"tilt_deg": tilt, "yaw_deg": yaw})


def expected(
    model: ErrorModel,
    p: np.ndarray,
    readings: np.ndarray,
    q: np.ndarray,
    channels: tuple[str, ...],
    sensor: Sensor,
) -> Measurements:
    """What instruments of `channels` with the sigmas of [sensor] see at these poses of the robot p, without noise.

    readings: (n, n_actuated); q: (n, n_joints), closed there or near by.
    """
    robot = model.robot(p)
    pose = robot.measured(robot.close(readings, q).pose)
    values = {c.name: c.of(pose) for c in named(channels)}
    std = {c: np.full(len(readings), sensor.sigma(c)) for c in channels}
    return Measurements(np.arange(len(readings)), readings, values, std)


def prior_sigma(parameters: Parameters) -> np.ndarray:
    """(n_parameters,) the tolerances, and for W and T a sigma so wide that it decides nothing that is seen at all."""
    return np.where(parameters.flat, FLAT, parameters.tolerance)


def information(model: ErrorModel, sites: Sites, channels: tuple[str, ...], sensor: Sensor) -> np.ndarray:
    """(n, rows a pose, n_parameters): whitened Jacobian J of planned poses, parameters in units of their prior's sigma.

    I + sum J'J is then the information after these poses. Of the robot as drawn, with W = T = 1.
    """
    p = np.zeros(len(model.parameters))
    measured = expected(model, p, sites.readings, sites.q, channels, sensor)
    return model.jacobian(p, measured, sites.q) * prior_sigma(model.parameters)
