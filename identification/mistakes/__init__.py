"""The usual mistakes in tables of measurements: a kind is one file, and its line here."""

from __future__ import annotations

from kincal.identification.mistakes.degrees import degrees
from kincal.identification.mistakes.mistake import Kind
from kincal.identification.mistakes.swapped import swapped_joints
from kincal.identification.mistakes.values import wrong_values

MISTAKES: tuple[Kind, ...] = (wrong_values, degrees, swapped_joints)
