"""Joint values: a sign, a zero, a unit, a scale."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.refit import refitted

_SMALL = 1e-5  # of a difference [m, rad, 1]
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_ANGLES = {"degrees": np.pi / 180, "revolutions": 2 * np.pi}


def joint_signs(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint that counts the other way round, from any zero."""
    for j, name in enumerate(model.chain.actuated_names):
        cause = f"{name} counts the other way round (the sign of actuator.{name}.gain)"
        yield Mistake(cause, lambda m, j=j: _shifted(model, _reversed(m, j), j))


def joint_zeros(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint with another zero."""
    for j, name in enumerate(model.chain.actuated_names):
        cause = f"{name} has another zero (actuator.{name}.zero)"
        yield Mistake(cause, lambda m, j=j: _shifted(model, m, j))


def joint_units(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint, or all of a kind, in another unit."""
    names, sliding = model.chain.actuated_names, model.chain.prismatic[model.chain.actuated]
    for slides, units, unit in ((True, _LENGTHS, "metres"), (False, _ANGLES, "radians")):
        chosen = [j for j in range(len(names)) if sliding[j] == slides]
        for other, factor in units.items():
            groups = [[j] for j in chosen] + ([chosen] if len(chosen) > 1 else [])
            for group in groups:
                which = names[group[0]] if len(group) == 1 else f"{names[group[0]]} and the other {len(group) - 1}"
                is_are = "is" if len(group) == 1 else "are"
                cause = f"{which} {is_are} in {other}, not {unit} (measure.columns gives a column's unit)"
                yield Mistake(cause, lambda m, g=tuple(group), f=factor: _scaled(m, g, f))


def common_scale(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """All actuators with one wrong scale: a belt, a screw's lead, steps for a millimetre."""
    everything = tuple(range(len(model.chain.actuated_names)))
    cause = "all actuators have one wrong scale (actuator.*.gain)"
    yield Mistake(cause, lambda m: refitted(model, m, lambda x: _scaled(m, everything, 1 + x), _SMALL))


def _reversed(m: Measurements, joint: int) -> Measurements:
    """About the middle of its readings; where the zero is, `_shifted` finds."""
    readings = m.readings.copy()
    readings[:, joint] = readings[:, joint].min() + readings[:, joint].max() - readings[:, joint]
    return replace(m, readings=readings)


def _shifted(model: ErrorModel, m: Measurements, joint: int) -> Measurements:
    def undone(x: float) -> Measurements:
        readings = m.readings.copy()
        readings[:, joint] += x / model.actuators.gain[joint]
        return replace(m, readings=readings)

    return refitted(model, m, undone, _SMALL)


def _scaled(m: Measurements, joints: tuple[int, ...], factor: float) -> Measurements:
    readings = m.readings.copy()
    readings[:, list(joints)] *= factor
    return replace(m, readings=readings)
