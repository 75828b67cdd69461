"""The methods side by side: their predictions, and the closed loop of a virtual robot."""

from __future__ import annotations

from kincal.pipeline.learned import Fits
from kincal.pipeline.results import RAW, Comparison, Compensated, Measured
from kincal.pipeline.stages.robot_data import DrawnRobot, Poses
from kincal.urdf.description import Evaluate


def compensate_stage(robot: DrawnRobot, fits: Fits, measured: Measured, evaluate: Evaluate, seed: int) -> Compensated:
    """The closed loop: commands for desired poses by each method, and where the virtual robot then is.

    Desired are poses that the robot as built can have, parasitic motion included: those of the nominal commands.
    Of a real robot nobody knows where it would be: its closed loop is measured, not computed.
    """
    if measured.truth is None or not evaluate.closed_loop:
        return Compensated(0, {}, ())
    import numpy as np

    from kincal.identification.channels import parts
    from kincal.pipeline.compensator.commands import attempt
    from kincal.pipeline.compensator.goal import filled
    from kincal.pipeline.compensator.solvers import Solvers
    from kincal.pipeline.methods.calibrated import calibrations
    from kincal.pipeline.methods.scores import method_score
    from kincal.pipeline.virtual.robot import VirtualRobot
    from kincal.urdf.workspace import sample

    errors = robot.errors
    calibrated, *_ = calibrations(errors, fits.identified, fits.transferred, fits.hybrids)
    channels = calibrated.channels
    # a little inside the workspace: commands differ from the nominal
    u = 0.98 * sample(robot.model.mechanism.workspace, errors.chain.tool_axes, evaluate.fresh_poses, [seed, 9])
    closure, readings = robot.closed(u, "compensate: desired pose")
    virtual = VirtualRobot.of(errors, measured.truth)
    actual = virtual.pose(readings, virtual.after_campaign(readings))
    drawn = errors.robot(calibrated.fit.registered)  # what was not measured can't be desired otherwise than as drawn
    desired = filled(parts(channels), actual, drawn.measured(closure.pose))
    scores, reached, solvers = [], {}, Solvers(robot.model.mechanism.workspace)
    for name, method in calibrated.methods.items():  # a network that has seen few poses may have no answer for some
        tried = attempt(solvers.of(method, channels), desired, errors.chain, errors.actuators)
        closure_there = virtual.close(tried.readings, virtual.after_campaign(tried.readings))
        rows = np.flatnonzero(tried.good(errors.chain, robot.model.mechanism.workspace) & closure_there.closed)
        reached[name] = len(rows)
        if len(rows):
            pose = virtual.robot.measured(closure_there.pose)
            scores.append(method_score(name, pose[rows], desired[rows], channels))
    return Compensated(len(u), reached, tuple(scores))


def evaluate_stage(
    poses: Poses, fits: Fits, measured: Measured, compensated: Compensated, evaluate: Evaluate, name: str
) -> Comparison:
    """The methods side by side, on poses that none of them has seen."""
    from kincal.pipeline.methods.advice import advise
    from kincal.pipeline.methods.calibrated import calibrations
    from kincal.pipeline.methods.predictors import uncalibrated
    from kincal.pipeline.methods.scores import cross_validated, scores
    from kincal.pipeline.stages.fresh_poses import fresh_poses

    errors, measurements = poses.errors, poses.fitted(fits.identified)
    channels = measurements.channels
    shipped, held_out, *folds = calibrations(errors, fits.identified, fits.transferred, fits.hybrids)
    test = measurements[held_out.fit.test]
    if measured.truth is None:
        at, actual = measurements, measurements.as_poses()
        methods = cross_validated([(fold.fit.test, fold.methods) for fold in folds], measurements, channels)
    else:
        at, actual = fresh_poses(poses, measured.truth, evaluate.fresh_poses, poses.seed)
        methods = scores(shipped.methods, at, actual, channels)
    return Comparison(
        robot=name,
        source=measured.source,
        n_poses=len(measurements),
        n_scored=len(at),
        scored_on="held_out" if measured.truth is None else "fresh",
        channels=channels,
        methods=methods,
        held_out=scores(held_out.methods, test, test.as_poses(), channels),
        n_held_out=len(test),
        raw_nominal=scores({RAW: uncalibrated(errors)}, at, actual, channels)[0],
        closed_loop=compensated.scores,
        not_reached={
            name: compensated.n_poses - n for name, n in compensated.reached.items() if n < compensated.n_poses
        },
        advice=advise(shipped, methods, measurements.readings, fits.identified.shipped.findings),
    )
