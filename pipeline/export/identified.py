"""The identified robot that is exported, and the check of what was read back against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.identification.identification import Identification
from kincal.pipeline.results import Model
from kincal.pipeline.run.provenance import made_of, provenance
from kincal.pipeline.run.runner import Run
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.urdf.description import Robot, RobotDescription
from kincal.urdf.errors import CalibrationError
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion, log
from kincal.urdf.workspace import sample

TOLERANCE = 1e-9  # of a pose that the export predicts, against the identified model [m, rad]
_RANDOM = 128  # readings at which an export is checked besides the measured ones; at least
_ENOUGH = 100  # of them the identified robot must reach


@dataclass(frozen=True)
class IdentifiedRobot:
    """The identified robot, and what it predicts at the readings where its export is checked."""

    source: Robot
    model: Model  # as drawn
    found: Identification
    measured: str  # virtual, or the file's name
    robot: BuiltRobot  # its home closed
    readings: np.ndarray  # (n, n_actuated) the measured ones, then random ones of the workspace
    tool: Motion  # (n) the tool's poses in the base frame there
    predicted: Motion  # (n) W * tool * T
    provenance: Mapping[str, Any] = field(default_factory=dict)
    made_of: str = ""  # the same in a line

    @property
    def description(self) -> RobotDescription:
        return self.source.description


@dataclass(frozen=True)
class Exported:
    """What was written and how well it was found to agree."""

    path: Path | None  # None: a document that was not written
    document: Mapping[str, Any] | None
    n_checked: int
    position: float  # the largest difference of a predicted pose [m]
    rotation: float  # [rad]
    instrument: str = ""  # the links that are W and T
    target: str = ""
    note: str = ""  # what could not stay as it was

    @property
    def lines(self) -> tuple[str, ...]:
        """For people, a sentence each."""
        within = f"within {self.position:.1e} m and {self.rotation:.1e} rad at {self.n_checked} readings"
        agrees = f"{self.path}: predicts as the identified model does, {within}"
        if not self.target:
            return (agrees,)
        return agrees, f"what is measured: the pose of link {self.target!r} in link {self.instrument!r}"


def identified_robot(session: Run) -> IdentifiedRobot:
    """Runs the stages up to `identify`, which raises where the fit fails its checks."""
    model, measured, filtered, identified = session.until("model", "measure", "filter", "identify")
    errors = DrawnRobot.of(model, session.robot.description).errors
    readings = filtered.table[list(errors.chain.actuated_names)].to_numpy(float)
    robot = errors.robot(identified.shipped.change)
    calibrated = calibrated_robot(session.robot, model, identified.shipped, measured.source, errors, robot, readings)
    command = session.entries["identify"].manifest["provenance"]["command"]  # so that exporting again changes no byte
    return replace(
        calibrated,
        provenance=provenance(session.entries, ["identify"], command),
        made_of=made_of(session.entries, "measure", "identify"),
    )


def calibrated_robot(
    source: Robot,
    model: Model,
    identification: Identification,
    measured: str,
    errors: ErrorModel,
    robot: BuiltRobot,
    readings: np.ndarray,
) -> IdentifiedRobot:
    """`robot` with all that is exported beside it, to be checked at the measured readings and at random ones."""
    chain = errors.chain
    home = robot.close(errors.actuators.readings(chain.home[None, chain.actuated]))
    u = sample(source.description.workspace, chain.tool_axes, _RANDOM, [source.description.seed, 40])
    drawn = inverse(chain, u)
    anywhere = errors.actuators.readings(drawn.q[drawn.closed][:, chain.actuated])
    anywhere = anywhere[robot.close(anywhere).closed]
    readings = np.concatenate([readings, anywhere])
    closure = robot.close(readings)
    open_rows = np.flatnonzero(~closure.closed)
    if len(open_rows) or len(anywhere) < _ENOUGH or not home.closed.all():
        where = f"row {open_rows[0]} of the measured readings" if len(open_rows) else "much of its workspace"
        raise CalibrationError(f"the identified robot can't close its loops at {where}; nothing was exported")
    closed = replace(robot, chain=replace(robot.chain, home=home.q[0], home_pose=home.pose[0]))
    predicted = robot.measured(closure.pose)
    return IdentifiedRobot(source, model, identification, measured, closed, readings, closure.pose, predicted)


def agreement(calibrated: IdentifiedRobot, closed: np.ndarray, tool: Motion, predicted: Motion) -> tuple[float, float]:
    """The largest differences [m, rad] of reloaded from identified poses (n). Raises CalibrationError beyond 1e-9."""
    if not closed.all():
        raise CalibrationError(
            f"the export can't close its loops at {np.sum(~closed)} of {len(closed)} readings where the identified "
            "robot can; nothing was exported"
        )
    pairs = ((calibrated.tool, tool), (calibrated.predicted, predicted))
    apart = [before.inverse() @ after for before, after in pairs]
    position = float(max(np.linalg.norm(m.translation, axis=-1).max() for m in apart))
    rotation = float(max(np.linalg.norm(log(m.rotation), axis=-1).max() for m in apart))
    if not max(position, rotation) <= TOLERANCE:
        raise CalibrationError(
            f"the export's predictions differ from the identified model's by {position:.3g} m and {rotation:.3g} rad; "
            f"allowed are {TOLERANCE:g}; nothing was exported"
        )
    return position, rotation
