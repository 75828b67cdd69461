"""The usual mistakes in tables of measurements: a kind is one file, and its line here."""

from __future__ import annotations

from kincal.identification.mistakes.axes import mirrored_axis, swapped_axes
from kincal.identification.mistakes.degrees import degrees
from kincal.identification.mistakes.instrument import instrument_scale
from kincal.identification.mistakes.joints import common_scale, joint_gains, joint_signs, joint_units, joint_zeros
from kincal.identification.mistakes.mistake import Kind
from kincal.identification.mistakes.parts import parts_that_are_off
from kincal.identification.mistakes.rotations import other_notation
from kincal.identification.mistakes.rows import (
    late_from_some_row,
    late_rows,
    repeated_rows,
    stuck_joints,
    unseen_target,
)
from kincal.identification.mistakes.swapped import swapped_joints
from kincal.identification.mistakes.values import wrong_values
from kincal.identification.mistakes.wrong_poses import wrong_poses

VALUES: tuple[Kind, ...] = (  # of what was measured, in all rows alike: a part of the poses shows them
    wrong_values,
    degrees,
    mirrored_axis,
    swapped_axes,
    other_notation,
)
TRANSFORMS: tuple[Kind, ...] = (  # of all rows alike, of the joints' too
    *VALUES,
    swapped_joints,
    joint_signs,
    joint_zeros,
    joint_units,
    joint_gains,
    common_scale,
    instrument_scale,
)
ROWS: tuple[Kind, ...] = (  # of some rows, or of their order
    unseen_target,
    repeated_rows,
    stuck_joints,
    late_rows,
    late_from_some_row,
    wrong_poses,
    parts_that_are_off,
)
