"""The identified robot as a folder with URDF, robot.toml and parameter table, which every command of kincal takes.

It is read back as kincal reads it, and must predict what the identified model predicts.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kincal.pipeline.export.calibration_json import parameters
from kincal.pipeline.export.identified import Exported, IdentifiedRobot, agreement, identified_robot
from kincal.pipeline.export.target import MADE_HERE, beside, check_folder_free
from kincal.pipeline.export.toml import exported_toml
from kincal.pipeline.export.urdf import CalibratedUrdf, calibrated_urdf, require_urdf
from kincal.pipeline.results import VIRTUAL, Model
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import version
from kincal.pipeline.stages import drawing
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain, load_chain
from kincal.urdf.description import Actuator, RobotDescription, Workspace, load_robot
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import forward
from kincal.urdf.rigid_motion import xyz_angles

FILES = ("robot.urdf", "robot.toml", "parameters.csv")
_SHARES = (1.0, 0.98, 0.95, 0.9)  # of the workspace, tried in turn where the calibrated robot does not reach it all


def export(session: Run, output: Path | None = None, force: bool = False, method: str | None = None) -> Exported:
    """The calibrated robot as a folder (default: NAME_calibrated).

    force: also into a folder that holds other things; those stay. Raises InputError for that, CalibrationError where
    the export does not predict what the identified model predicts; then nothing is written.
    """
    output = Path(f"{session.robot.description.name}_calibrated") if output is None else output
    check_folder_free(output, session.robot, force, output / "robot.toml")
    require_urdf(session.until("model")[0].urdf)
    calibrated = identified_robot(session)
    with beside(output) as temporary:
        exported = write_folder(calibrated, temporary, output)
        check_folder_free(output, session.robot, force, output / "robot.toml")
        if output.exists():
            for name in FILES:
                (temporary / name).replace(output / name)
        else:
            temporary.rename(output)
    return replace(exported, path=output)


def write_folder(calibrated: IdentifiedRobot, folder: Path, final: Path) -> Exported:
    """The three files in `folder`, checked; `final` is where the folder will stand, for relative paths."""
    description, identification = calibrated.description, calibrated.found
    chi_square = f"{identification.chi_square:.5g} over {identification.degrees_of_freedom:.1f} degrees of freedom"
    origin = (
        f"{MADE_HERE}{description.name}, identified from {identification.n_poses} poses ({calibrated.measured}: "
        f"{', '.join(identification.channels)}), chi-square {chi_square}, "
        f"kincal {version('kincal')}{calibrated.made_of and ', '}{calibrated.made_of}"
    )
    warning = [VIRTUAL] * (calibrated.measured == "virtual")
    urdf = calibrated_urdf(calibrated.model.urdf, calibrated.robot, calibrated.model.mechanism, [origin, *warning])
    (folder / "robot.urdf").write_bytes(urdf.text.encode())
    (folder / "parameters.csv").write_bytes(parameters_csv(calibrated).encode())
    shown = f"pose of link {urdf.target!r} in link {urdf.instrument!r} = W * tool pose * T: what kincal predicts"
    exported, note, refusal = _described(calibrated, urdf), "", None
    for workspace, change in _workspaces(calibrated):
        trial = exported.model_copy(update={"workspace": workspace}) if change else exported
        note = f"{change}, because of {refusal}" if change else ""
        text = exported_toml(trial, calibrated.source.file, final, [origin, *warning, shown, *([note] if note else [])])
        (folder / "robot.toml").write_bytes(text.encode())
        reloaded = load_robot(str(folder / "robot.toml")).description
        try:
            model = drawing.model_stage(reloaded.mechanism, reloaded.urdf)
            break
        except InputError as error:
            refusal = refusal or error
    else:
        raise CalibrationError(f"the calibrated robot's workspace fails its checks: {refusal}; nothing was exported")
    apart = _check_reloaded(calibrated, reloaded, model, urdf)
    n = len(calibrated.readings)
    return Exported(folder, None, n, *apart, instrument=urdf.instrument, target=urdf.target, note=note)


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
        change = "workspace: about the pose to which the home commands of the drawing lead"
        yield (
            _shrunk(stands, share).model_copy(update=moved),
            change if share == 1 else f"{change}, and {share:.0%} of it",
        )


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
    return agreement(calibrated, closure.closed & in_instrument.closed, closure.pose, in_instrument.pose)


def _same_structure(one: ClosedChain, other: ClosedChain) -> bool:
    arrays = ("axes", "prismatic", "lower", "upper", "actuated")
    return (one.joint_names, one.parents) == (other.joint_names, other.parents) and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays
    )
