"""The residual network of the actuators, and the virtual siblings that it inherits from."""

from __future__ import annotations

from kincal.pipeline.results import Filtered, Hybrids, Identified, Model, SiblingResiduals
from kincal.pipeline.stages.robot_data import closed, error_model, used_poses
from kincal.urdf.description import Actuator, Correct, Plan, Sensor, Siblings, Split, Tolerance


def siblings(model: Model, siblings: Siblings, tolerance: Tolerance, actuator: dict[str, Actuator]) -> SiblingResiduals:
    """What geometry does not explain of virtual robots of this design, learned once for all that are built."""
    from kincal.identification.poses import planned
    from kincal.learning.inherit import inherit
    from kincal.pipeline.virtual.siblings import residuals, unexplained

    errors = error_model(model, tolerance, actuator)
    plan = Plan(poses=siblings.poses, layout="random")
    u = planned(model.mechanism.workspace, errors.chain.tool_axes, plan, siblings.seed)
    closure, readings = closed(errors, u, "siblings: pose")
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
    from kincal.pipeline.methods.residual_network import corrected

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed).scaled(identified.shipped.sensor_estimated)
    inherited, known = siblings.inherited, not identified.shipped.sensor_estimated
    return Hybrids(tuple(corrected(errors, poses, fit, inherited, correct, seed, known) for fit in identified.fits()))
