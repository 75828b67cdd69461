"""The stages: plain typed functions, values in, values out.

A parameter annotated with a result (`Model`, `Measured`, ...) is another stage's output; any other is a setting, the
table of robot.toml of that name. Heavy imports happen inside, so that a cached run loads none of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.results import (
    Comparison,
    Fit,
    Html,
    Identified,
    Measured,
    Model,
    PosePlan,
    Report,
    Urdf,
)
from urdf.description import (
    Actuator,
    Evaluate,
    Identify,
    Measure,
    Mechanism,
    Plan,
    Sensor,
    Split,
    Tolerance,
)
from urdf.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from identification.error_model import ErrorModel
    from identification.measurements import Measurements


def model(mechanism: Mechanism, urdf: Path) -> Model:
    """URDF and loop closures -> a checked closed chain with its home configuration."""
    import numpy as np

    from urdf.closed_chain import load_chain
    from urdf.kinematics import at_home
    from urdf.rigid_motion import Motion, from_xyz_angles
    from urdf.workspace import check_workspace

    text = _read(urdf)
    chain = load_chain(mechanism, text, urdf)
    workspace, home = mechanism.workspace, None
    if workspace.home_mm is not None or workspace.home_rotation_deg is not None:
        angles = np.deg2rad(workspace.home_rotation_deg or (0.0, 0.0, 0.0))
        home = Motion(from_xyz_angles(angles), np.array(workspace.home_mm or (0.0, 0.0, 0.0)) * 1e-3)
    chain = at_home(chain, home)
    report = check_workspace(chain, workspace)
    return Model(
        mechanism=mechanism,
        urdf=Urdf(text),
        home=chain.home,
        home_pose=chain.home_pose.vector(),
        joints=chain.joint_names,
        mobility=report.mobility,
        worst_condition=report.worst_condition,
        worst_pose=report.worst_pose,
        n_checked=report.n_checked,
    )


def plan(model: Model, plan: Plan, actuator: dict[str, Actuator], seed: int) -> PosePlan:
    """Which poses to measure: the paper's uniform grid, or random poses."""
    import pandas as pd

    from identification.poses import planned
    from urdf.actuators import Actuators
    from urdf.kinematics import inverse
    from urdf.workspace import AXES, check_limits

    chain = model.chain()
    u = planned(model.mechanism.workspace, chain.tool_axes, plan, seed)
    closure = inverse(chain, u).require(lambda row: f"plan: pose {row}")
    check_limits(chain, closure.q, lambda row: f"plan: pose {row}")
    readings = Actuators.nominal(chain, actuator).readings(closure.q[:, chain.actuated])
    columns = {name: readings[:, k] for k, name in enumerate(chain.actuated_names)}
    columns |= {f"planned_{AXES[a]}": u[:, a] for a in chain.tool_axes}
    return PosePlan(pd.DataFrame({"pose": range(len(u)), **columns}))


def measure(
    model: Model,
    plan: PosePlan,
    measure: Measure,
    sensor: Sensor,
    actuator: dict[str, Actuator],
    tolerance: Tolerance,
    seed: int,
) -> Measured:
    """The measurement table: read from a file, or measured by a virtual robot on itself."""
    from identification.error_model import ErrorModel
    from identification.measurements import check_readings, read_table, to_table

    chain = model.chain()
    nominal = ErrorModel.of(chain, actuator, tolerance)
    if not measure.virtual:
        assert measure.table is not None
        table = read_table(measure.table, chain.actuated_names, measure)
        check_readings(table, chain, nominal.actuators, tolerance, measure.table)
        return Measured(measure.table.name, table, None)
    from pipeline.virtual_robot import VirtualRobot, default_channels, draw
    from pipeline.virtual_robot import measure as sense

    truth = draw(nominal, measure.errors, seed)
    readings = plan.table[list(chain.actuated_names)].to_numpy()
    pose = VirtualRobot.of(nominal, truth).pose(readings)
    channels = measure.channels or default_channels(chain.tool_axes)
    return Measured("virtual", to_table(chain.actuated_names, readings, sense(pose, channels, sensor, seed)), truth)


def identify(
    model: Model,
    measured: Measured,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    identify: Identify,
    seed: int,
) -> Identified:
    """All geometric parameters from the measured poses; and from parts of them, to be scored on the rest."""
    from identification.error_model import ErrorModel
    from identification.estimators import identify as estimate
    from identification.estimators import register
    from identification.measurements import to_measurements
    from identification.poses import folds, held_out
    from identification.summary import summarise

    chain = model.chain()
    errors = ErrorModel.of(chain, actuator, tolerance)
    poses = to_measurements(measured.table, chain.actuated_names, sensor)
    whole = estimate(errors, poses, identify.max_iterations)
    parts = () if measured.truth is not None else folds(len(poses), split, seed)
    return Identified(
        shipped=summarise(errors, poses, whole),
        registered=register(errors, poses).p,
        held_out=_fit(errors, poses, held_out(len(poses), split, seed), identify),
        folds=tuple(_fit(errors, poses, test, identify) for test in parts),
    )


def evaluate(
    model: Model,
    measured: Measured,
    identified: Identified,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    evaluate: Evaluate,
    name: str,
    seed: int,
) -> Comparison:
    """The methods side by side, on poses that none of them has seen."""
    from identification.error_model import ErrorModel
    from identification.measurements import to_measurements
    from pipeline.comparison import RAW, cross_validated, measured_poses, of_fit, raw, scores, shipped

    chain = model.chain()
    errors = ErrorModel.of(chain, actuator, tolerance)
    poses = to_measurements(measured.table, chain.actuated_names, sensor)
    channels = poses.channels
    test = poses[identified.held_out.test]
    if measured.truth is None:
        at, actual = poses, measured_poses(poses)
        methods = cross_validated(errors, identified.folds, poses, channels)
    else:
        at, actual = _fresh(model, errors, measured.truth, evaluate.fresh_poses, seed)
        methods = scores(errors, shipped(identified), at, actual, channels)
    return Comparison(
        robot=name,
        source=measured.source,
        n_poses=len(poses),
        n_scored=len(at),
        scored_on="held_out" if measured.truth is None else "fresh",
        channels=channels,
        methods=methods,
        held_out=scores(errors, of_fit(identified.held_out), test, measured_poses(test), channels),
        raw_nominal=scores(errors, {RAW: raw(errors)}, at, actual, channels)[0],
    )


def report(model: Model, measured: Measured, identified: Identified, compared: Comparison) -> Report:
    """A page to sign: comparison, parameters, singular values, residuals."""
    from pipeline.report import page

    return Report(Html(page(model, measured, identified, compared)))


def _fit(errors: ErrorModel, poses: Measurements, test: np.ndarray, settings: Identify) -> Fit:
    import numpy as np

    from identification.estimators import identify as estimate
    from identification.estimators import register

    train = poses[np.setdiff1d(np.arange(len(poses)), test)]
    return Fit(test, register(errors, train).p, estimate(errors, train, settings.max_iterations).p)


def _fresh(model: Model, errors: ErrorModel, truth, n: int, seed: int):
    """Random poses of the workspace, and where the virtual robot really goes there, without noise."""
    import numpy as np

    from identification.measurements import Measurements
    from pipeline.virtual_robot import VirtualRobot
    from urdf.kinematics import inverse
    from urdf.workspace import sample

    chain = errors.chain
    u = sample(model.mechanism.workspace, chain.tool_axes, n, [seed, 5])
    closure = inverse(chain, u).require(lambda row: f"evaluate: fresh pose {row}")
    readings = errors.actuators.readings(closure.q[:, chain.actuated])
    return Measurements(np.arange(n), readings), VirtualRobot.of(errors, truth).pose(readings)


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{file}: not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{file}: can't be read: {error.strerror}") from None


# In the order in which they run, with the libraries whose major.minor version is part of their result.
STAGES = {
    model: ("numpy", "scipy", "pin"),
    plan: ("numpy", "scipy", "pandas", "pyarrow"),
    measure: ("numpy", "scipy", "pandas", "pyarrow"),
    identify: ("numpy", "scipy", "casadi"),
    evaluate: ("numpy", "scipy"),
    report: ("jinja2", "matplotlib"),
}
