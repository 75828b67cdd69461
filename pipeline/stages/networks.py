"""The paper's networks: what they are pre-trained on, and what they learn from the measured poses."""

from __future__ import annotations

from kincal.pipeline.results import Filtered, Identified, Model, Pretrained, SourceTask, Transferred
from kincal.pipeline.stages.robot_data import closed, error_model, used_poses
from kincal.urdf.description import Actuator, Plan, Pretrain, Prior, Sensor, Split, Tolerance, Transfer


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
    from kincal.identification.poses import planned
    from kincal.pipeline.methods.networks import source_task

    errors = error_model(model, tolerance, actuator)
    u = planned(model.mechanism.workspace, errors.chain.tool_axes, Plan(poses=prior.poses), seed)
    _, readings = closed(errors, u, "prior: pose")
    return source_task(errors, readings, identified, pretrain)


def pretrain(task: SourceTask, pretrain: Pretrain, seed: int) -> Pretrained:
    """Networks trained on the source task: the paper's prior."""
    from kincal.pipeline.methods.networks import pretrained

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
    from kincal.pipeline.methods.networks import learned

    errors = error_model(model, tolerance, actuator)
    poses = used_poses(filtered, errors, sensor, split, seed)
    return Transferred(learned(errors, poses, identified, task, pretrained, pretrain, transfer, seed))
