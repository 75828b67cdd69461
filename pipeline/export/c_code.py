"""The compensator for a controller: a folder with one C file, its header and a test program.

Compiled and compared with what `kincal compensate` and `kincal predict` say before it is handed out; without a compiler
its steps are, as CasADi evaluates them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kincal.identification.compiled import find_compiler
from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.code import code_name, sources
from kincal.pipeline.compensator.compensator import Compensator
from kincal.pipeline.compensator.library import Library
from kincal.pipeline.compensator.solver import ModelSolver
from kincal.pipeline.export.identified import TOLERANCE
from kincal.pipeline.export.target import MADE_HERE, beside, check_folder_free
from kincal.pipeline.methods.calibrated import CalibratedRobot
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.pipeline.results import VIRTUAL
from kincal.pipeline.run.calibrated import calibrated
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import version
from kincal.urdf.description import Workspace
from kincal.urdf.errors import CalibrationError
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import sample

_CHECKED = 300  # random poses of the workspace


@dataclass(frozen=True)
class Agreement:
    """The largest differences from what kincal itself says."""

    n_checked: int
    command: float  # of an actuator's joint [m, rad]
    prediction: float | None  # of a predicted pose [m, rad]; None: the code was not compiled


@dataclass(frozen=True)
class ExportedCode:
    """What was written, and how well it agrees."""

    path: Path
    name: str  # of its files, and what its functions' names begin with
    agreement: Agreement
    compiler: str | None
    iterations: int  # of a command, at most
    document: None = None

    @property
    def note(self) -> str:
        if self.compiler is not None:
            return ""
        return "there is no C compiler here; the code's steps were compared as CasADi evaluates them, not compiled"

    @property
    def lines(self) -> tuple[str, ...]:
        """For people, a sentence each."""
        within = f"within {self.agreement.command:.1e} m or rad of an actuator at {self.agreement.n_checked} poses"
        agrees = f"{self.path}: commands as kincal compensate does, {within}"
        return agrees, f"at most {self.iterations} iterations a command, from any start"


def export(
    session: Run, output: Path | None = None, force: bool = False, method: str | None = "hybrid"
) -> ExportedCode:
    """The compensator as C in a folder (default: NAME_compensator).

    force: also into a folder that holds other things; those stay. Raises InputError for that and for methods without
    code, CalibrationError where the code does not say what the method says; then nothing is written.
    """
    assert method is not None
    description = session.robot.description
    output, name = output or Path(f"{description.name}_compensator"), code_name(description.name)
    marker = output / f"{name}.h"
    check_folder_free(output, session.robot, force, marker)
    robot = calibrated(session.robot.description, session.until, method)
    chosen = robot.methods[method]
    assert isinstance(chosen, ModelMethod | HybridMethod)
    compensator = Compensator.of(chosen, robot.channels, description.workspace)
    files = sources(compensator, name, _said(session, robot, chosen, method))
    agreed, compiler = _checked(compensator.solver, description.workspace, files, name)
    with beside(output) as temporary:
        for file, text in files.items():
            (temporary / file).write_text(text, encoding="utf-8")
        check_folder_free(output, session.robot, force, marker)
        if output.exists():
            for file in files:
                (temporary / file).replace(output / file)
        else:
            temporary.rename(output)
    most = compensator.most.inverse + compensator.most.hybrid
    return ExportedCode(output, name, agreed, compiler, most)


def _said(session: Run, robot: CalibratedRobot, method: ModelMethod | HybridMethod, name: str) -> list[str]:
    """Where the code comes from."""
    fit = robot.identification
    measured = session.until("measure")[0].source
    remarks = [
        f"{MADE_HERE}{session.robot.description.name}, compensator of the {name} method, identified from {fit.n_poses} "
        f"poses ({measured}: {', '.join(fit.channels)}), kincal {version('kincal')}, casadi "
        f"{version('casadi')}",
        *[VIRTUAL] * (measured == "virtual"),
        f"identification: sha256 {session.entries['identify'].digest}",
    ]
    if isinstance(method, HybridMethod):
        correction = method.correction
        used = f"{correction.structure}; {correction.shrinkage:.3g} of it" if correction.shrinkage else "not used"
        remarks.append(f"correction ({used}): sha256 {session.entries['correct'].digest}")
    return remarks


def _checked(
    solver: ModelSolver, workspace: Workspace, files: Mapping[str, str], name: str
) -> tuple[Agreement, str | None]:
    """Compiled and compared all over the workspace; with the compiler's command."""
    chain, compiler = solver.robot.chain, find_compiler()
    u = sample(workspace, chain.tool_axes, _CHECKED, [0, 43])
    if compiler is None:
        return agreement(solver, u, None), None
    counts = (len(chain.actuated), chain.n_joints, len(chain.passive))
    with tempfile.TemporaryDirectory() as folder:
        library = Library.of(files, name, counts, compiler, Path(folder))
        return agreement(solver, u, library), compiler


def agreement(solver: ModelSolver, u: np.ndarray, library: Library | None) -> Agreement:
    """At tool coordinates u: (n, 6). Raises CalibrationError where the code does not say what `kincal compensate` says.

    library: None: the commands are compared with what the method predicts there.
    """
    method, robot = solver.method, solver.robot
    configurations = inverse(robot.chain, u)
    readings = robot.actuators.readings(configurations.q[configurations.closed][:, robot.chain.actuated])
    desired = method.predict(readings)
    commanded = solver.commands(desired)
    expected, reached, prediction = commanded.readings, commanded.reached, None
    if library is None:
        got, by_code = readings, reached
    else:
        answers, poses = library.commands(desired), library.predictions(readings)
        got, by_code = answers.values, answers.found & poses.found
        prediction = _apart(desired, poses.values)
    if not by_code[reached].all() or not reached.any():
        raise CalibrationError(
            f"--format c: the code does not get to {np.sum(reached & ~by_code)} of {np.sum(reached)} poses that "
            "kincal compensate gets to; nothing was exported"
        )
    command = float(np.abs(robot.actuators.gain * (got - expected))[reached].max())
    if not max(command, prediction or 0.0) <= TOLERANCE:
        raise CalibrationError(
            f"--format c: the code's commands differ by {command:.3g} m or rad and its predictions by "
            f"{prediction or 0.0:.3g}; allowed are {TOLERANCE:g}; nothing was exported"
        )
    return Agreement(int(reached.sum()), command, prediction)


def _apart(pose: Motion, values: np.ndarray) -> float:
    """The largest difference of positions and quaternions (n, 7) from poses (n) [m, rad]."""
    here = quaternions(pose.rotation)
    quaternion = values[:, 3:] * np.sign(np.sum(here * values[:, 3:], axis=1))[:, None]
    moved = np.linalg.norm(values[:, :3] - pose.translation, axis=1).max()
    return float(max(moved, 2 * np.linalg.norm(quaternion - here, axis=1).max()))
