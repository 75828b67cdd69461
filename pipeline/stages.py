"""The stages: plain typed functions, values in, values out.

A parameter annotated with a result (`Model`, `Measured`, ...) is another stage's output; any other is a setting, the
table of robot.toml of that name. Heavy imports happen inside, so that a cached run loads none of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.results import (
    RAW,
    Comparison,
    Compensated,
    Filtered,
    Fit,
    Html,
    Hybrids,
    Identified,
    Measured,
    Model,
    PosePlan,
    Pretrained,
    Report,
    SiblingResiduals,
    SourceTask,
    Transferred,
    Truth,
    Urdf,
)
from urdf.description import (
    Actuator,
    Correct,
    Evaluate,
    Filter,
    Identify,
    Instruments,
    Measure,
    Mechanism,
    Plan,
    Pretrain,
    Prior,
    Sensor,
    Siblings,
    Split,
    Tolerance,
    Transfer,
)

if TYPE_CHECKING:
    import numpy as np

    from identification.error_model import ErrorModel
    from identification.measurements import Measurements
    from urdf.closed_chain import ClosedChain
    from urdf.kinematics import Closure
    from urdf.rigid_motion import Motion


def model(mechanism: Mechanism, urdf: Path) -> Model:
    """URDF or MJCF and loop closures -> a checked closed chain with its home configuration."""
    from urdf.assembly import assembled
    from urdf.input_files import read_text

    text = read_text(urdf)
    chain, report = assembled(mechanism, text, urdf)
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


def plan(
    model: Model, plan: Plan, actuator: dict[str, Actuator], instruments: Instruments | None, seed: int
) -> PosePlan:
    """Which poses to measure: the paper's uniform grid, random poses, or D-optimal ones."""
    import pandas as pd

    from identification.poses import planned
    from urdf.actuators import Actuators
    from urdf.kinematics import inverse
    from urdf.workspace import AXES, check_limits

    chain = model.chain()
    if instruments is None:
        u = planned(model.mechanism.workspace, chain.tool_axes, plan, seed)
    else:
        from identification.d_optimal import d_optimal
        from identification.error_model import ErrorModel
        from identification.expected import of_one_row

        errors = ErrorModel.of(chain, actuator, instruments.tolerance)
        channels, sensor = of_one_row(instruments, chain.tool_axes)
        sites = d_optimal(errors, model.mechanism.workspace, channels, sensor, plan.poses, seed)
        u = sites.in_travel_order(chain).u
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
    """The measurement table and streams: read from files, or measured by a virtual robot on itself."""
    from identification.measurements import to_table
    from pipeline.virtual_robot import VirtualRobot, default_channels, draw, stream_of
    from pipeline.virtual_robot import measure as sense

    nominal = error_model(model, tolerance, actuator)
    chain = nominal.chain
    if not measure.virtual:
        return _from_files(chain, nominal, measure, tolerance)
    seed = seed if measure.seed is None else measure.seed
    truth = draw(nominal, measure.errors, seed)
    readings = plan.table[list(chain.actuated_names)].to_numpy()
    robot = VirtualRobot.of(nominal, truth)
    pose, cross_axis = robot.pose(readings, robot.campaign(readings)), measure.errors.cross_axis
    channels = measure.channels or default_channels(chain.tool_axes)
    # a stream is an inclinometer's: a heading without tilt comes as one reading a pose
    streamed = tuple(c for c in channels if c in ("tilt", "yaw")) if measure.stream and "tilt" in channels else ()
    columns = sense(pose, tuple(c for c in channels if c not in streamed), sensor, seed, cross_axis)
    stream = None
    if measure.stream and streamed:
        stream = stream_of(pose, streamed, sensor, measure.stream, seed, cross_axis)
    return Measured("virtual", to_table(chain.actuated_names, readings, columns), stream, truth)


def filter(measured: Measured, filter: Filter, sensor: Sensor) -> Filtered:
    """Raw streams -> one row a pose, by the extended Kalman filter; a table without streams goes through as it is.

    Poses that a stream does not tell are left out.
    """
    if measured.stream is None:
        return Filtered(measured.table, 0, 0)
    from identification.inclinometer import filter_stream

    table = measured.table
    found = filter_stream(measured.stream, table["pose"].to_numpy(), sensor, filter, f"stream ({measured.source})")
    used, gated = (int(found.rows[name].to_numpy().sum()) for name in ("used", "gated"))
    rows = found.rows.drop(columns=["used", "gated"])
    table = table.merge(rows, on="pose", validate="1:1")
    return Filtered(table, used, gated, found.dropped, found.innovations, found.yaw_stuck)


def identify(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    identify: Identify,
    seed: int,
) -> Identified:
    """All geometric parameters from the measured poses; and from parts of them, to be scored on the rest."""
    from identification.diagnosis import registered as register
    from identification.estimators import identify as estimate
    from identification.poses import folds, held_out
    from identification.summary import summarise

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed)
    parts = () if measured.truth is not None else folds(len(poses), split, seed)
    test = held_out(len(poses), split, seed)
    registered = register(errors, poses, identify.max_iterations)
    whole = estimate(errors, poses, identify, registered)
    shipped = summarise(errors, poses, whole, registered, identify)
    poses = poses.scaled(shipped.sensor_estimated)
    return Identified(
        shipped=shipped,
        registered=registered.p,
        held_out=_fit(errors, poses, test, identify),
        folds=tuple(_fit(errors, poses, part, identify) for part in parts),
    )


def prior(
    model: Model,
    identified: Identified,
    prior: Prior,
    pretrain: Pretrain,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    seed: int,
) -> SourceTask:
    """The source task: a uniform grid up to three axes, as in the paper, else evenly spread poses; all nominal."""
    from identification.poses import planned
    from pipeline.learn import source_task

    errors = error_model(model, tolerance, actuator)
    u = planned(model.mechanism.workspace, errors.chain.tool_axes, Plan(poses=prior.poses), seed)
    _, readings = _closed(errors, u, "prior: pose")
    return source_task(errors, readings, identified, pretrain)


def pretrain(task: SourceTask, pretrain: Pretrain, seed: int) -> Pretrained:
    """Networks trained on the source task: the paper's prior."""
    from pipeline.learn import pretrained

    return pretrained(task, pretrain, seed)


def transfer(
    model: Model,
    filtered: Filtered,
    identified: Identified,
    task: SourceTask,
    pretrained: Pretrained,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    pretrain: Pretrain,
    transfer: Transfer,
    seed: int,
) -> Transferred:
    """The paper's networks, fine-tuned on measured poses; and the same from the identified model's prior."""
    from pipeline.learn import learned

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed)
    return Transferred(learned(errors, poses, identified, task, pretrained, pretrain, transfer, seed))


def siblings(model: Model, siblings: Siblings, tolerance: Tolerance, actuator: dict[str, Actuator]) -> SiblingResiduals:
    """What geometry does not explain of virtual robots of this design, learned once for all that are built."""
    from identification.poses import planned
    from learning.inherit import inherit
    from pipeline.siblings import residuals, unexplained

    errors = error_model(model, tolerance, actuator)
    plan = Plan(poses=siblings.poses, layout="random")
    u = planned(model.mechanism.workspace, errors.chain.tool_axes, plan, siblings.seed)
    closure, readings = _closed(errors, u, "siblings: pose")
    give = residuals(errors.chain, closure.q, siblings.count, siblings.seed)
    inherited, curve = inherit(
        readings,
        unexplained(errors, readings, closure.q, give),
        hidden=siblings.hidden,
        iterations=siblings.iterations,
        seed=siblings.seed,
    )
    return SiblingResiduals(inherited, curve)


def correct(
    model: Model,
    filtered: Filtered,
    identified: Identified,
    siblings: SiblingResiduals,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    correct: Correct,
    seed: int,
) -> Hybrids:
    """The residual network of the actuators, and the geometry refined beside it."""
    from pipeline.correct import corrected

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed).scaled(identified.shipped.sensor_estimated)
    inherited, known = siblings.inherited, not identified.shipped.sensor_estimated
    return Hybrids(tuple(corrected(errors, poses, fit, inherited, correct, seed, known) for fit in identified.fits()))


def compensate(
    model: Model,
    measured: Measured,
    identified: Identified,
    transferred: Transferred,
    hybrids: Hybrids,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    evaluate: Evaluate,
    seed: int,
) -> Compensated:
    """The closed loop: commands for desired poses by each method, and where the virtual robot then is.

    Desired are poses that the robot as built can have, parasitic motion included: those of the nominal commands.
    Of a real robot nobody knows where it would be: its closed loop is measured, not computed.
    """
    if measured.truth is None or not evaluate.closed_loop:
        return Compensated(0, {}, ())
    import numpy as np

    from identification.channels import parts
    from pipeline.comparison import method_score
    from pipeline.compensation import attempt
    from pipeline.goal import Goal
    from pipeline.methods import build
    from pipeline.virtual_robot import VirtualRobot
    from urdf.workspace import sample

    errors = error_model(model, tolerance, actuator)
    channels = identified.shipped.channels
    methods = build(errors, identified.fits()[0], transferred.fits[0], hybrids.fits[0], channels)
    # a little inside the workspace: commands differ from the nominal
    u = 0.98 * sample(model.mechanism.workspace, errors.chain.tool_axes, evaluate.fresh_poses, [seed, 9])
    closure, readings = _closed(errors, u, "compensate: desired pose")
    robot = VirtualRobot.of(errors, measured.truth)
    actual = robot.pose(readings, robot.after_campaign(readings))
    drawn = errors.robot(identified.registered)  # what was not measured can't be desired otherwise than as drawn
    desired = Goal(drawn, actual, parts(channels)).filled(drawn.measured(closure.pose))
    scores, reached = [], {}
    for name, method in methods.items():  # a network that has seen few poses may have no answer for some
        tried = attempt(method, desired, errors.chain, errors.actuators, channels)
        there = robot.close(tried.readings, robot.after_campaign(tried.readings))
        rows = np.flatnonzero(tried.good(errors.chain, model.mechanism.workspace) & there.closed)
        reached[name] = len(rows)
        if len(rows):
            pose = robot.robot.measured(there.pose)
            scores.append(method_score(name, pose[rows], desired[rows], channels))
    return Compensated(len(u), reached, tuple(scores))


def evaluate(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    identified: Identified,
    transferred: Transferred,
    hybrids: Hybrids,
    compensated: Compensated,
    sensor: Sensor,
    tolerance: Tolerance,
    actuator: dict[str, Actuator],
    split: Split,
    evaluate: Evaluate,
    name: str,
    seed: int,
) -> Comparison:
    """The methods side by side, on poses that none of them has seen."""
    from pipeline.advice import advise
    from pipeline.comparison import cross_validated, scores
    from pipeline.methods import build, uncalibrated

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed)
    channels = poses.channels
    parts = zip(identified.fits(), transferred.fits, hybrids.fits, strict=True)
    fits = [(fit, build(errors, fit, learned, own, channels)) for fit, learned, own in parts]
    held_out, by_held_out = fits[1]
    test = poses[held_out.test]
    if measured.truth is None:
        at, actual = poses, poses.as_poses()
        methods = cross_validated([(fit.test, by_fold) for fit, by_fold in fits[2:]], poses, channels)
    else:
        at, actual = fresh_poses(model, errors, measured.truth, evaluate.fresh_poses, seed)
        methods = scores(fits[0][1], at, actual, channels)
    return Comparison(
        robot=name,
        source=measured.source,
        n_poses=len(poses),
        n_scored=len(at),
        scored_on="held_out" if measured.truth is None else "fresh",
        channels=channels,
        methods=methods,
        held_out=scores(by_held_out, test, test.as_poses(), channels),
        raw_nominal=scores({RAW: uncalibrated(errors)}, at, actual, channels)[0],
        closed_loop=compensated.scores,
        not_reached={
            name: compensated.n_poses - n for name, n in compensated.reached.items() if n < compensated.n_poses
        },
        advice=advise(errors, fits[0][0], hybrids.fits[0], fits[0][1], methods, poses.readings, channels),
    )


def report(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    identified: Identified,
    pretrained: Pretrained,
    transferred: Transferred,
    siblings: SiblingResiduals,
    hybrids: Hybrids,
    compared: Comparison,
) -> Report:
    """A page to sign: comparison, parameters, singular values, residuals, training."""
    from pipeline.report import page

    return Report(
        Html(page(model, measured.campaign, filtered, identified, pretrained, transferred, siblings, hybrids, compared))
    )


def _from_files(chain: ClosedChain, nominal: ErrorModel, measure: Measure, tolerance: Tolerance) -> Measured:
    """Static poses as a table; joint values and a stream that names poses; or a log and the commands of its time."""
    from identification.measurements import check_readings, read_table
    from identification.streams.campaign import Campaign
    from identification.streams.reading import read_stream
    from identification.streams.static_poses import static_poses

    if measure.commands is not None:
        found = static_poses(measure, chain.actuated_names)
        check_readings(found.table, chain, nominal.actuators, tolerance, measure.commands)
        return Measured(found.campaign.health.file, found.table, found.stream, None, found.campaign)
    assert measure.table is not None
    settings = measure if measure.streams is None else measure.of_columns(("pose", *chain.actuated_names))
    table = read_table(measure.table, chain.actuated_names, settings, measured=measure.streams is None)
    check_readings(table, chain, nominal.actuators, tolerance, measure.table)
    if measure.streams is None:
        return Measured(measure.table.name, table, None, None)
    stream, health = read_stream(measure.streams, measure)
    return Measured(health.file, table, stream, None, Campaign(health, None, len(table), len(table), ()))


def error_model(model: Model, tolerance: Tolerance, actuator: dict[str, Actuator]) -> ErrorModel:
    """Of the robot as drawn."""
    from identification.error_model import ErrorModel

    return ErrorModel.of(model.chain(), actuator, tolerance)


def used_poses(filtered: Filtered, errors: ErrorModel, sensor: Sensor, split: Split, seed: int) -> Measurements:
    """The measured poses, or as many of them as [split] asks for."""
    from identification.measurements import to_measurements
    from identification.poses import chosen

    poses = to_measurements(filtered.table, errors.chain.actuated_names, sensor)
    return poses if split.poses is None else poses[chosen(len(poses), split.poses, seed)]


def _fit(errors: ErrorModel, poses: Measurements, test: np.ndarray, settings: Identify) -> Fit:
    import numpy as np

    from identification.estimators import identify as estimate
    from identification.estimators import register

    train = poses[np.setdiff1d(np.arange(len(poses)), test)]
    registered = register(errors, train, settings.max_iterations)
    return Fit(test, registered.p, estimate(errors, train, settings, registered).p)


def fresh_poses(model: Model, errors: ErrorModel, truth: Truth, n: int, seed: int) -> tuple[Measurements, Motion]:
    """Random poses of the workspace, and where the virtual robot really goes there, without noise: warm, one by one."""
    import numpy as np

    from identification.measurements import Measurements
    from pipeline.virtual_robot import VirtualRobot
    from urdf.workspace import sample

    u = sample(model.mechanism.workspace, errors.chain.tool_axes, n, [seed, 5])
    _, readings = _closed(errors, u, "evaluate: fresh pose")
    robot = VirtualRobot.of(errors, truth)
    return Measurements(np.arange(n), readings), robot.pose(readings, robot.after_campaign(readings))


def _closed(errors: ErrorModel, u: np.ndarray, what: str) -> tuple[Closure, np.ndarray]:
    """The robot as drawn with its tool at u (n, 6), and the readings there. Raises InputError that says `what` row."""
    from urdf.kinematics import inverse

    closure = inverse(errors.chain, u).require(lambda row: f"{what} {row}")
    return closure, errors.actuators.readings(closure.q[:, errors.chain.actuated])


# In the order in which they run, with the libraries whose major.minor version is part of their result.
STAGES = {
    model: ("numpy", "scipy", "pin"),
    plan: ("numpy", "scipy", "casadi", "pandas", "pyarrow"),
    measure: ("numpy", "scipy", "pandas", "pyarrow", "pynmeagps", "rosbags"),
    filter: ("numpy", "filterpy", "pandas", "pyarrow"),
    identify: ("numpy", "scipy", "casadi"),
    prior: ("numpy", "scipy"),
    pretrain: ("numpy", "torch"),
    transfer: ("numpy", "torch"),
    siblings: ("numpy", "torch"),
    correct: ("numpy", "scipy", "casadi"),
    compensate: ("numpy",),
    evaluate: ("numpy", "scipy"),
    report: ("jinja2", "matplotlib"),
}
