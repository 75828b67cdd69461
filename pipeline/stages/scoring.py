"""The methods side by side: their predictions, and the closed loop of a virtual robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kincal.pipeline.results import (
    RAW,
    Comparison,
    Compensated,
    Filtered,
    Hybrids,
    Identified,
    Measured,
    Model,
    Transferred,
)
from kincal.pipeline.stages.robot_data import closed, error_model, used_poses
from kincal.urdf.description import Actuator, Evaluate, Sensor, Split, Tolerance

if TYPE_CHECKING:
    pass


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

    from kincal.identification.channels import parts
    from kincal.pipeline.methods.commands import attempt
    from kincal.pipeline.methods.goal import Goal
    from kincal.pipeline.methods.predictors import build
    from kincal.pipeline.methods.scores import method_score
    from kincal.pipeline.virtual.robot import VirtualRobot
    from kincal.urdf.workspace import sample

    errors = error_model(model, tolerance, actuator)
    channels = identified.shipped.channels
    methods = build(errors, identified.fits()[0], transferred.fits[0], hybrids.fits[0], channels)
    # a little inside the workspace: commands differ from the nominal
    u = 0.98 * sample(model.mechanism.workspace, errors.chain.tool_axes, evaluate.fresh_poses, [seed, 9])
    closure, readings = closed(errors, u, "compensate: desired pose")
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
    from kincal.pipeline.methods.advice import advise
    from kincal.pipeline.methods.predictors import build, uncalibrated
    from kincal.pipeline.methods.scores import cross_validated, scores
    from kincal.pipeline.stages.fresh_poses import fresh_poses

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
