"""The residual network of the actuators, and the virtual siblings that it inherits from."""

from __future__ import annotations

from kincal.pipeline.learned import Hybrids, SiblingResiduals
from kincal.pipeline.results import Identified
from kincal.pipeline.stages.robot_data import DrawnRobot, Poses
from kincal.pipeline.watch import advanced
from kincal.urdf.description import Correct, Plan, Siblings


def siblings_stage(robot: DrawnRobot, siblings: Siblings) -> SiblingResiduals:
    """What geometry does not explain of virtual robots of this design, learned once for all that are built."""
    from kincal.identification.poses import planned
    from kincal.learning.inherit import inherit
    from kincal.pipeline.virtual.siblings import residuals, unexplained

    errors = robot.errors
    plan = Plan(poses=siblings.poses, layout="random")
    u = planned(robot.model.mechanism.workspace, errors.chain.tool_axes, plan, siblings.seed)
    closure, readings = robot.closed(u, "siblings: pose")
    give = residuals(errors.chain, closure.q, siblings.count, siblings.seed)
    inherited, curve = inherit(
        readings,
        unexplained(errors, readings, closure.q, give),
        hidden=siblings.hidden,
        iterations=siblings.iterations,
        seed=siblings.seed,
        progress=lambda done, _: advanced(done / siblings.iterations),
    )
    return SiblingResiduals(inherited, curve)


def correct_stage(poses: Poses, identified: Identified, siblings: SiblingResiduals, correct: Correct) -> Hybrids:
    """The residual network of the actuators, and the geometry refined beside it."""
    from kincal.pipeline.methods.residual_network import corrected

    estimated, inherited, seed = identified.shipped.sensor_estimated, siblings.inherited, poses.seed
    errors, measured = poses.errors, poses.fitted(identified).scaled(estimated)
    made, fits = [], identified.fits()
    for fit in fits:
        made.append(corrected(errors, measured, fit, inherited, correct, seed, not estimated))
        advanced(len(made) / len(fits))
    return Hybrids(tuple(made))
