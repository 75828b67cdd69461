"""The robot as drawn."""

from __future__ import annotations

from pathlib import Path

from kincal.pipeline.results import Model, Urdf
from kincal.urdf.description import Mechanism


def model_stage(mechanism: Mechanism, urdf: Path) -> Model:
    """URDF or MJCF and loop closures -> a checked closed chain with its home configuration."""
    from kincal.urdf.assembly import assembled
    from kincal.urdf.input_files import read_text

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
