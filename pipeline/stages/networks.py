"""The paper's networks: what they are pre-trained on, and what they learn from the measured poses."""

from __future__ import annotations

from kincal.pipeline.learned import Pretrained, SourceTask, Transferred
from kincal.pipeline.results import Identified
from kincal.pipeline.stages.robot_data import DrawnRobot, Poses
from kincal.urdf.description import Plan, Pretrain, Prior, Transfer


def prior_stage(robot: DrawnRobot, identified: Identified, prior: Prior, pretrain: Pretrain, seed: int) -> SourceTask:
    """The source task: a uniform grid up to three axes, as in the paper, else evenly spread poses; all nominal."""
    from kincal.identification.poses import planned
    from kincal.pipeline.methods.networks import source_task

    u = planned(robot.model.mechanism.workspace, robot.errors.chain.tool_axes, Plan(poses=prior.poses), seed)
    _, readings = robot.closed(u, "prior: pose")
    return source_task(robot.errors, readings, identified, pretrain)


def pretrain_stage(task: SourceTask, pretrain: Pretrain, seed: int) -> Pretrained:
    """Networks trained on the source task: the paper's prior."""
    from kincal.pipeline.methods.networks import pretrained

    return pretrained(task, pretrain, seed)


def transfer_stage(
    poses: Poses,
    identified: Identified,
    task: SourceTask,
    pretrained: Pretrained,
    pretrain: Pretrain,
    transfer: Transfer,
) -> Transferred:
    """The paper's networks, fine-tuned on measured poses; and the same from the identified model's prior."""
    from kincal.pipeline.methods.networks import learned

    return Transferred(
        learned(poses.errors, poses.fitted(identified), identified, task, pretrained, pretrain, transfer, poses.seed)
    )
