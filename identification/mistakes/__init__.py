"""The usual mistakes in tables of measurements: a kind is one file, and its line here."""

from __future__ import annotations

from kincal.identification.mistakes.axes import mirrored_axis, swapped_axes
from kincal.identification.mistakes.degrees import degrees
from kincal.identification.mistakes.joints import common_scale, joint_signs, joint_units, joint_zeros
from kincal.identification.mistakes.mistake import Kind
from kincal.identification.mistakes.moved import moved_instrument
from kincal.identification.mistakes.rotations import other_notation
from kincal.identification.mistakes.rows import late_rows, repeated_rows, unseen_target, wrong_poses
from kincal.identification.mistakes.swapped import swapped_joints
from kincal.identification.mistakes.values import wrong_values

TRANSFORMS: tuple[Kind, ...] = (  # of all rows alike: a part of the poses shows them
    wrong_values,
    degrees,
    swapped_joints,
    mirrored_axis,
    swapped_axes,
    other_notation,
    joint_signs,
    joint_zeros,
    joint_units,
    common_scale,
)
ROWS: tuple[Kind, ...] = (unseen_target, repeated_rows, late_rows, wrong_poses, moved_instrument)  # of some rows
