"""The identified robot for others: a folder with URDF, robot.toml and parameter table, or one JSON document.

Whatever is handed out has been read back by those who would read it, and predicts what the identified model predicts.
"""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.identification.identification import Identification
from kincal.pipeline.export.document import SCHEMA, calibration_document, parameters, read_calibration
from kincal.pipeline.export.target import MADE_HERE, beside, check_folder_free, check_parent
from kincal.pipeline.export.toml import exported_toml
from kincal.pipeline.export.urdf import CalibratedUrdf, calibrated_urdf, require_urdf
from kincal.pipeline.results import Model
from kincal.pipeline.run.provenance import made_of, provenance
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import version
from kincal.pipeline.stages import drawing
from kincal.pipeline.store.files import refusing, replace_file
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain, load_chain
from kincal.urdf.description import Actuator, Robot, RobotDescription, Workspace, load_robot
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import forward, inverse
from kincal.urdf.rigid_motion import Motion, log, xyz_angles
from kincal.urdf.workspace import sample

TOLERANCE = 1e-9  # of a pose that the export predicts, against the identified model [m, rad]
FILES = ("robot.urdf", "robot.toml", "parameters.csv")
_RANDOM = 128  # readings at which an export is checked besides the measured ones; at least
_ENOUGH = 100  # of them the identified robot must reach
_SHARES = (1.0, 0.98, 0.95, 0.9)  # of the workspace, tried in turn where the calibrated robot does not reach it all


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


def export_folder(session: Run, output: Path | None = None, force: bool = False) -> Exported:
    """The calibrated robot as a folder (default: NAME_calibrated) that every command of kincal takes.

    force: also into a folder that holds other things; those stay. Raises InputError for that, CalibrationError where
    the export does not predict what the identified model predicts; then nothing is written.
    """
    output = Path(f"{session.robot.description.name}_calibrated") if output is None else output
    check_folder_free(output, session.robot.file, force, output / "robot.toml")
    require_urdf(session.until("model")[0].urdf)
    calibrated = identified_robot(session)
    with beside(output) as temporary:
        exported = write_folder(calibrated, temporary, output)
        check_folder_free(output, session.robot.file, force, output / "robot.toml")
        if output.exists():
            for name in FILES:
                (temporary / name).replace(output / name)
        else:
            temporary.rename(output)
    return replace(exported, path=output)


def export_document(session: Run, output: Path | None = None, force: bool = False) -> Exported:
    """The calibrated robot as one JSON document, written to `output` where that is given."""
    _check_file_free(output, force)
    calibrated = identified_robot(session)
    document = calibration_document(
        calibrated.description, calibrated.robot, calibrated.found, calibrated.measured, _versions()
    )
    document |= {"provenance": dict(calibrated.provenance)}
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    robot = read_calibration(json.loads(text))
    closure = robot.close(calibrated.readings)
    agreement = _agreement(calibrated, closure.closed, closure.pose, robot.measured(closure.pose))
    if output is not None:
        _check_file_free(output, force)
        with refusing(f"--output {output}"):
            replace_file(output, text.encode())
    return Exported(output, document, len(calibrated.readings), *agreement)


def identified_robot(session: Run) -> IdentifiedRobot:
    """Runs the stages up to `identify`, which raises where the fit fails its checks."""
    model, measured, filtered, identified = session.until("model", "measure", "filter", "identify")
    description = session.robot.description
    errors = ErrorModel.of(model.chain(), description.actuator, description.tolerance)
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
    found: Identification,
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
    return IdentifiedRobot(source, model, found, measured, closed, readings, closure.pose, predicted)


def write_folder(calibrated: IdentifiedRobot, folder: Path, final: Path) -> Exported:
    """The three files in `folder`, checked; `final` is where the folder will stand, for relative paths."""
    description, found = calibrated.description, calibrated.found
    said = (
        f"{MADE_HERE}{description.name}, identified from {found.n_poses} poses ({calibrated.measured}: "
        f"{', '.join(found.channels)}), chi-square {found.chi_square:.5g} over {found.degrees_of_freedom:.1f} degrees "
        f"of freedom, kincal {version('kincal')}{calibrated.made_of and ', '}{calibrated.made_of}"
    )
    urdf = calibrated_urdf(calibrated.model.urdf, calibrated.robot, calibrated.model.mechanism, [said])
    (folder / "robot.urdf").write_bytes(urdf.text.encode())
    (folder / "parameters.csv").write_bytes(parameters_csv(calibrated).encode())
    shown = f"pose of link {urdf.target!r} in link {urdf.instrument!r} = W * tool pose * T: what kincal predicts"
    exported, note, refusal = _described(calibrated, urdf), "", None
    for workspace, change in _workspaces(calibrated):
        trial = exported.model_copy(update={"workspace": workspace}) if change else exported
        note = f"{change}, because of {refusal}" if change else ""
        text = exported_toml(trial, calibrated.source.file, final, [said, shown, *([note] if note else [])])
        (folder / "robot.toml").write_bytes(text.encode())
        reloaded = load_robot(str(folder / "robot.toml")).description
        try:
            model = drawing.model(reloaded.mechanism, reloaded.urdf)
            break
        except InputError as error:
            refusal = refusal or error
    else:
        raise CalibrationError(f"the calibrated robot's workspace fails its checks: {refusal}; nothing was exported")
    agreement = _check_reloaded(calibrated, reloaded, model, urdf)
    n = len(calibrated.readings)
    return Exported(folder, None, n, *agreement, instrument=urdf.instrument, target=urdf.target, note=note)


def parameters_csv(calibrated: IdentifiedRobot) -> str:
    """The parameter table in SI units and radians, in full precision; sigma is empty where nothing sees a parameter."""
    columns = ("name", "unit", "initial", "final", "change", "sigma", "identifiable")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in parameters(calibrated.description.name, calibrated.found):
        shown = row | {"identifiable": "yes" if row["identifiable"] else "no"}
        writer.writerow(["" if shown[c] is None else shown[c] for c in columns])
    return text.getvalue()


def _described(calibrated: IdentifiedRobot, urdf: CalibratedUrdf) -> RobotDescription:
    """The description with the identified actuators and the URDF's own frames."""
    description, robot = calibrated.description, calibrated.robot
    loops = zip(description.loop, urdf.loop_frames, strict=True)
    loop = tuple(loop.model_copy(update={"frames": frames}) for loop, frames in loops)
    numbers = zip(robot.chain.actuated_names, robot.actuators.gain, robot.actuators.zero, strict=True)
    actuator = {name: Actuator(gain=float(gain), zero=float(zero)) for name, gain, zero in numbers}
    update: dict[str, Any] = {"urdf": Path("robot.urdf"), "actuator": actuator}
    return description.model_copy(update=update | ({"loop": loop} if loop else {}))


def _workspaces(calibrated: IdentifiedRobot) -> Iterator[tuple[Workspace, str]]:
    """The workspace as it stands; then what is nearest to it, for a robot that was drawn to the edge of its limits."""
    stands, home = calibrated.description.workspace, calibrated.robot.chain.home_pose
    for share in _SHARES:
        yield _shrunk(stands, share), "" if share == 1 else f"workspace: {share:.0%} of the drawing's"
    moved = {
        "home_mm": tuple((1e3 * home.translation).tolist()),
        "home_rotation_deg": tuple(np.rad2deg(xyz_angles(home.rotation)).tolist()),
    }
    for share in _SHARES:
        what = "workspace: about the pose to which the home commands of the drawing lead"
        yield _shrunk(stands, share).model_copy(update=moved), what if share == 1 else f"{what}, and {share:.0%} of it"


def _shrunk(workspace: Workspace, share: float) -> Workspace:
    ranges = {name: getattr(workspace, name) for name in ("rotation_deg", "translation_mm")}
    update = {
        name: {axis: (share * low, share * high) for axis, (low, high) in axes.items()}
        for name, axes in ranges.items()
        if axes
    }
    return workspace if share == 1 else workspace.model_copy(update=update)


def _check_reloaded(
    calibrated: IdentifiedRobot, description: RobotDescription, model: Model, urdf: CalibratedUrdf
) -> tuple[float, float]:
    """Refuse a folder whose robot is another one than the identified. What was read back predicts:
    the tool in the base frame, and the target's link in the instrument's."""
    chain = model.chain()
    if not _same_structure(chain, calibrated.robot.chain):
        raise CalibrationError("the exported URDF has other joints than the robot's own; nothing was exported")
    joints = Actuators.nominal(chain, description.actuator).joints(calibrated.readings)
    closure = forward(chain, joints)
    frames = {"base_frame": urdf.instrument, "tool_frame": urdf.target}
    seen = load_chain(model.mechanism.model_copy(update=frames), model.urdf, description.urdf)
    in_instrument = forward(replace(seen, home=chain.home, home_pose=chain.home_pose), joints)
    return _agreement(calibrated, closure.closed & in_instrument.closed, closure.pose, in_instrument.pose)


def _same_structure(one: ClosedChain, other: ClosedChain) -> bool:
    arrays = ("axes", "prismatic", "lower", "upper", "actuated")
    return (one.joint_names, one.parents) == (other.joint_names, other.parents) and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays
    )


def _agreement(calibrated: IdentifiedRobot, closed: np.ndarray, tool: Motion, predicted: Motion) -> tuple[float, float]:
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


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("kincal", "pin", "numpy")} | {"python": platform.python_version()}


def _check_file_free(output: Path | None, force: bool) -> None:
    if output is None:
        return
    with refusing(f"--output {output}"):
        check_parent(output)
        if not os.path.lexists(output):
            return
        if not output.is_file():
            raise InputError(f"--output {output}: no file; allowed is a new file")
        if not force and not _is_calibration(output):
            raise InputError(
                f"--output {output}: exists, and was not made by kincal export; name a new file, or replace it with "
                "--force"
            )


def _is_calibration(file: Path) -> bool:
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("schema") == SCHEMA
