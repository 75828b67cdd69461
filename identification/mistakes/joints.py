"""Joint values: a sign, a zero, a unit, a scale."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kincal.identification.channels.channel import LENGTHS
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.refit import refitted
from kincal.identification.mistakes.registered import registered
from kincal.urdf.errors import InputError

_SMALL = 1e-5  # of a difference [m, rad, 1]
_FACTORS = (1.0, 0.5, 2.0, 1 / 3, 3.0, 0.25, 4.0, 0.2, 5.0, 0.1, 10.0)
_ANGLES = {"degrees": np.pi / 180, "revolutions": 2 * np.pi}


def joint_signs(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint that counts the other way round, from any zero; and all of them."""
    for j, name in enumerate(model.chain.actuated_names):
        cause = f"{name} counts the other way round (the sign of actuator.{name}.gain)"
        yield Mistake(cause, lambda m, j=j: _reversed(model, m, j))
    gains = ", ".join(f"actuator.{name}.gain" for name in model.chain.actuated_names)
    for middle in (False, True):
        yield Mistake(f"all joints count the other way round (the signs of {gains})", lambda m, a=middle: _turned(m, a))


def joint_zeros(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint with another zero."""
    for j, name in enumerate(model.chain.actuated_names):
        cause = f"{name} has another zero (actuator.{name}.zero)"
        yield Mistake(cause, lambda m, j=j: _shifted(model, m, j))


def joint_units(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint, or all of a kind, in another unit."""
    names, sliding = model.chain.actuated_names, model.chain.prismatic[model.chain.actuated]
    for slides, units, unit in ((True, LENGTHS, "metres"), (False, _ANGLES, "radians")):
        chosen = [j for j in range(len(names)) if sliding[j] == slides]
        for other, factor in units.items():
            groups = [[j] for j in chosen] + ([chosen] if len(chosen) > 1 else [])
            for group in groups:
                which = names[group[0]] if len(group) == 1 else f"{names[group[0]]} and the other {len(group) - 1}"
                is_are = "is" if len(group) == 1 else "are"
                cause = f"{which} {is_are} in {other}, not {unit} (measure.columns gives a column's unit)"
                yield Mistake(cause, lambda m, g=tuple(group), f=factor: _scaled(m, g, f))


def joint_gains(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """One joint whose readings are longer or shorter by some factor: a gear, a lead, microsteps."""
    for j, name in enumerate(model.chain.actuated_names):
        factor = _best_factor(model, measured, j)
        if factor is not None:
            cause = f"{name} has another scale (actuator.{name}.gain)"
            yield Mistake(cause, lambda m, j=j, f=factor: _regained(model, m, (j,), f))


def common_scale(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """All actuators with one wrong scale: a belt, a screw's lead, steps for a millimetre."""
    everything = tuple(range(len(model.chain.actuated_names)))
    gains = ", ".join(f"actuator.{name}.gain" for name in model.chain.actuated_names)
    yield Mistake(f"all actuators have one wrong scale ({gains})", lambda m: _regained(model, m, everything, 1.0))


def _best_factor(model: ErrorModel, measured: Measurements, joint: int) -> float | None:
    """By which the joint's readings fit best, to begin with; None: by none the loops close."""
    sizes: dict[float, float] = {}
    for factor in _FACTORS:
        try:
            sizes[factor] = registered(model, _scaled(measured, (joint,), factor)).size
        except (InputError, np.linalg.LinAlgError):
            continue
    return min(sizes, key=lambda factor: sizes[factor]) if sizes else None


def _regained(model: ErrorModel, m: Measurements, joints: tuple[int, ...], factor: float) -> Measurements:
    return refitted(model, m, lambda x: _scaled(m, joints, factor * (1 + x)), _SMALL)


def _turned(m: Measurements, about_middle: bool) -> Measurements:
    """All joints, about zero or about the middle of their readings."""
    about = m.readings.min(axis=0) + m.readings.max(axis=0) if about_middle else 0.0
    return replace(m, readings=about - m.readings)


def _reversed(model: ErrorModel, m: Measurements, joint: int) -> Measurements:
    """About zero, or about the middle of its readings, or about whatever zero fits best from there."""
    values = m.readings[:, joint]
    tried: list[tuple[float, int, Measurements]] = []
    for about in (0.0, values.min() + values.max()):
        readings = m.readings.copy()
        readings[:, joint] = about - values
        turned = replace(m, readings=readings)
        for undone in (lambda m: m, lambda m: _shifted(model, m, joint)):
            try:
                one = undone(turned)
                tried.append((registered(model, one).size, len(tried), one))
            except (InputError, np.linalg.LinAlgError):
                continue
    if not tried:
        raise InputError("the loops can't be closed with the joint the other way round")
    return min(tried, key=lambda entry: entry[:2])[2]


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
