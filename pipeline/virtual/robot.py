"""A robot with known errors that measures itself.

Geometric errors are drawn from the tolerances, on every placement and actuator; W and T are off by a degree. All
others (virtual_errors.py) shift the actuated joints, and the loops stay closed; its instruments add their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.constants import g

from kincal.identification.channels import CHANNELS
from kincal.identification.channels.instrument import read_angles
from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.identification.measurements import default_channels as default_channels
from kincal.pipeline.results import Truth
from kincal.pipeline.virtual import errors as terms
from kincal.pipeline.virtual.errors import Circumstances
from kincal.urdf.description import Sensor, Stream, VirtualErrors
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import Closure, forward, passive_rates, tool_point_jacobian
from kincal.urdf.rigid_motion import Motion

STANDING = np.array([0.0, 0.0, g])  # the specific force where nothing moves [m/s2]
_SETTLING = 3  # iterations of load and deflection; each gains some four digits
_MOST_SAMPLES = 5_000_000  # of a stream: a gigabyte


def draw(model: ErrorModel, errors: VirtualErrors, seed: int) -> Truth:
    """A robot at random."""
    random = np.random.default_rng([seed, 1])
    parameters = model.parameters
    p = random.normal(size=len(parameters)) * np.where(parameters.flat, 0.0, parameters.tolerance)
    if not errors.geometric:
        p[:] = 0.0
    for frame in (p[-12:-6], p[-6:]):
        for part, size in (
            (slice(0, 3), errors.frame_translation_mm * 1e-3),
            (slice(3, 6), np.deg2rad(errors.frame_rotation_deg)),
        ):
            direction = random.normal(size=3)
            frame[part] = size * direction / np.linalg.norm(direction)
    k = len(model.actuators.gain)
    sign = np.random.default_rng([seed, 20]).choice([-1.0, 1.0], k)  # a generator of its own leaves the other draws be
    return Truth(p, random.uniform(0, 2 * np.pi, k), sign, errors)


@dataclass(frozen=True)
class VirtualRobot:
    """The robot as built, its non-geometric errors included."""

    robot: BuiltRobot
    truth: Truth
    home: np.ndarray  # (n_actuated,) nominal joint values at home
    home_readings: np.ndarray  # (n_actuated,) the readings that the drawing has there

    @staticmethod
    def of(model: ErrorModel, truth: Truth) -> VirtualRobot:
        home = model.chain.home[model.chain.actuated]
        return VirtualRobot(model.robot(truth.p), truth, home, model.actuators.readings(home))

    def campaign(self, readings: np.ndarray) -> Circumstances:
        """Readings (n, n_actuated) that are measured one after the other, from home: the robot warms up."""
        return Circumstances(self._approaches(readings), terms.warming_up(len(readings)))

    def after_campaign(self, readings: np.ndarray) -> Circumstances:
        """Readings (n, n_actuated) that follow each other, from home, on the robot as the campaign left it: warm."""
        return Circumstances(self._approaches(readings), np.ones(len(readings)))

    def close(
        self, readings: np.ndarray, circumstances: Circumstances | None = None, force: np.ndarray = STANDING
    ) -> Closure:
        """The true configurations at the actuators' readings (n, n_actuated), and whether the robot can be there.

        circumstances: of the same n readings; None: cold, and every backlash in its middle. force: (3,) or (n, 3) the
        specific force where the robot stands, in the measurement frame [m/s2]: what the payload weighs, a kilogram.
        """
        chain, errors, sliding = self.robot.chain, self.truth.errors, self._sliding
        joints = self.robot.actuators.joints(readings)
        if errors.screw:
            joints = joints + terms.screw(errors, sliding, joints, self.home, self.truth.phase)
        if circumstances is not None:
            joints = joints + terms.backlash(errors, sliding, circumstances.approach)
            joints = joints + terms.thermal_growth(errors, sliding, self.truth.growth_sign, circumstances.warmth)
        closure = forward(chain, joints)
        rows = np.flatnonzero(closure.closed)
        if not len(rows):
            return closure
        force = np.broadcast_to(force, (len(readings), 3))[rows]
        if errors.clearance_mm or errors.clearance_deg:
            # by the load before the shift: near zero load, a sign that followed its own shift would not settle
            joints[rows] += terms.clearance(errors, sliding, self.load(closure.q[rows], force))
            closure = closure.replaced(rows, forward(chain, joints[rows], closure.q[rows]))
        if errors.elastic:
            for _ in range(_SETTLING):
                deflection = terms.deflection(errors, sliding, self.load(closure.q[rows], force))
                closure = closure.replaced(rows, forward(chain, joints[rows] + deflection, closure.q[rows]))
        return closure

    def pose(
        self, readings: np.ndarray, circumstances: Circumstances | None = None, force: np.ndarray = STANDING
    ) -> Motion:
        """The true poses (n) in the measurement frame at the actuators' readings (n, n_actuated); else as `close`."""
        closure = self.close(readings, circumstances, force)
        closure = closure.require(lambda row: f"virtual robot: readings of row {row}")
        return self.robot.measured(closure.pose)

    def load(self, q: np.ndarray, force: np.ndarray = STANDING) -> np.ndarray:
        """(n, n_actuated) [N, N m]: what the payload's weight puts on each actuator, by virtual work: -m f dx / dq.

        force: (3,) or (n, 3) as in `close`; standing still, it is g along the instrument's z.
        """
        chain, errors = self.robot.chain, self.truth.errors
        force = np.broadcast_to(force, (len(q), 3)) @ (chain.base.rotation @ self.robot.instrument.rotation.T).T
        centre = np.array(errors.payload_centre_mm) * 1e-3
        raised = np.einsum("ni,nij,njk->nk", force, tool_point_jacobian(chain, q, centre), passive_rates(chain, q))
        return -errors.payload_kg * raised

    def _approaches(self, readings: np.ndarray) -> np.ndarray:
        joints = self.robot.actuators.joints
        return terms.approaches(joints(readings), joints(self.home_readings))

    @property
    def _sliding(self) -> np.ndarray:
        return self.robot.chain.prismatic[self.robot.chain.actuated]


def stream_of(
    pose: Motion, channels: tuple[str, ...], sensor: Sensor, stream: Stream, seed: int, cross_axis: float = 0.0
) -> pd.DataFrame:
    """Raw samples of an inclinometer (and a heading reference) on true poses (n): noise, outliers, dropouts.

    cross_axis: how much of one angle its axes read into another.
    """
    random = np.random.default_rng([seed, 10])
    n, per_pose = len(pose.translation), max(1, round(stream.rate_hz * stream.seconds))
    count = n * per_pose
    if count > _MOST_SAMPLES:
        raise InputError(
            f"measure.stream: {count} samples of {n} poses; allowed are {_MOST_SAMPLES}: lower rate_hz or seconds"
        )
    read = read_angles(np.repeat(pose.rotation, per_pose, axis=0), cross_axis)
    columns = {"t": np.arange(count) / stream.rate_hz, "pose": np.repeat(np.arange(n), per_pose)}
    outlier = {"tilt": random.random(count) < stream.outliers, "yaw": random.random(count) < stream.outliers}
    for name in ("roll", "pitch", "yaw") if "yaw" in channels else ("roll", "pitch"):
        kind = "yaw" if name == "yaw" else "tilt"
        noise = sensor.sigma("yaw" if kind == "yaw" else "tilt") * random.normal(size=count)
        wrong = np.deg2rad(stream.outlier_deg) * random.choice([-1.0, 1.0], count)
        columns[name] = read[name] + noise + np.where(outlier[kind], wrong, 0.0)
    received = random.random(count) >= stream.dropouts
    return pd.DataFrame({name: values[received] for name, values in columns.items()})


def measure(
    pose: Motion, channels: tuple[str, ...], sensor: Sensor, seed: int, cross_axis: float = 0.0
) -> dict[str, np.ndarray]:
    """Columns of a measurement table: true poses (n) with each sensor's noise, and its cross-axis error."""
    random = np.random.default_rng([seed, 2])
    columns: dict[str, np.ndarray] = {}
    for channel in (c for c in CHANNELS if c.name in channels):
        values = channel.noisy(channel.sensed(pose, cross_axis), sensor.sigma(channel.name), random)
        columns |= channel.write(values)
    return columns
