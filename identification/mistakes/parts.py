"""A part that is off in some rows: it moved, it drifts, it settles, or it stops elsewhere from the other side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake
from kincal.identification.mistakes.offset import Offset, Offsets, Part, without
from kincal.urdf.rigid_motion import Motion, log

DRIFT = "a drift of"  # `drift_finding` tells of it too
_FEWEST = 8  # poses
_APART = 6  # poses before and after a move
_JUMP_TIMES, _LAW_TIMES = 3, 2  # linearisations
_SHARE = 0.5  # of the fall that the best law brings, the least of one that is worth a look
_SETTLING = (0.05, 0.15)  # of the rows, after which 1/e is left


@dataclass(frozen=True)
class _Law:
    """How the offset goes, over a range of 1, with the rows."""

    words: str  # before the name of the part, and behind it
    behind: str
    share: float = 0.0  # of the rows: of settling
    by_direction: bool = False

    def profile(self, m: Measurements, part: Part) -> np.ndarray:
        """(n,)"""
        if self.by_direction and isinstance(part, int):
            readings = m.readings[:, part]
            return 0.5 * np.sign(np.diff(readings, prepend=readings[0]))
        rows = np.arange(len(m)) / max(len(m) - 1, 1)
        return np.exp(-rows / self.share) if self.share else rows - 0.5


_LAWS = (
    _Law(DRIFT, "from the first pose to the last"),
    *(_Law("settling of", "at the first pose", share=share) for share in _SETTLING),
    _Law("backlash of", "between the directions of approach", by_direction=True),
)


@dataclass(frozen=True)
class _Tried:
    """A part that is off by a law."""

    law: _Law
    part: Part
    offset: Offset

    def words(self, model: ErrorModel) -> str:
        size = self.offset.size
        if isinstance(self.part, int):
            name = model.chain.actuated_names[self.part]
            slides = model.chain.prismatic[model.chain.actuated[self.part]]
            unit, factor = HUMAN["m" if slides else "rad"]
            far = f"{factor * size[0]:+.3g} {unit}"
        else:
            name = f"the {self.part}"
            far = f"{np.rad2deg(np.linalg.norm(size[3:])):.3g} deg and {1e3 * np.linalg.norm(size[:3]):.3g} mm"
        along = " along the rows" if self.law.words == DRIFT else ""
        return f"{self.law.words} {name}{along} ({far} {self.law.behind})"


def parts_that_are_off(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """From some row on, or by a law."""
    if len(measured) < _FEWEST:
        return
    offsets = Offsets.of(model, measured)
    if len(measured) >= 2 * _APART:
        yield from _moved(offsets)
    yield from _by_law(offsets)


def _moved(offsets: Offsets) -> Iterator[Mistake]:
    """The instrument, or the target, sits elsewhere from some row on: a tripod that was bumped, a target set anew."""
    m = offsets.measured
    parts: tuple[Part, ...] = ("instrument", "target")
    for part in parts:
        first, offset = offsets.from_some_row(part, _APART)
        when = f"between poses {m.pose[first - 1]} and {m.pose[first]}"
        undone = partial(without, offsets.model, part=part, profile=partial(_from_row, first=first), times=_JUMP_TIMES)
        cause = f"the {part} moved {when} ({_far(offsets, part, offset)})"
        yield Mistake(cause, undone, foreseen=offsets.foreseen(offset))


def _by_law(offsets: Offsets) -> Iterator[Mistake]:
    """One actuator, or the instrument: temperature, a slipping coupling, a tripod that sinks."""
    model, m = offsets.model, offsets.measured
    pairs = _laws_of_parts(len(model.chain.actuated_names))
    tried = [_Tried(law, part, offsets.along(part, law.profile(m, part))) for law, part in pairs]
    most = max(one.offset.fall for one in tried)
    for one in tried:
        if one.offset.fall > _SHARE * most:
            profile = partial(one.law.profile, part=one.part)
            undone = partial(without, model, part=one.part, profile=profile, times=_LAW_TIMES)
            yield Mistake(one.words(model), undone, lasting=True, foreseen=offsets.foreseen(one.offset))


def _laws_of_parts(n_joints: int) -> Iterator[tuple[_Law, Part]]:
    for law in _LAWS:
        for joint in range(n_joints):
            yield law, joint
        if not law.by_direction:
            yield law, "instrument"


def _from_row(m: Measurements, first: int) -> np.ndarray:
    return (np.arange(len(m)) >= first).astype(float)


def _far(offsets: Offsets, part: Part, offset: Offset) -> str:
    """How far the target seems to have moved: by its turn, and where positions are measured by their mean shift."""
    move = Motion.from_vector(offset.size)
    turned = f"{np.rad2deg(np.linalg.norm(log(move.rotation))):.2g} deg"
    shift = 1e3 * np.mean(
        np.linalg.norm(offsets.moved(part, move).translation - offsets.robot.predicted.translation, axis=1)
    )
    return f"{shift:.2g} mm, {turned}" if "position" in offsets.measured.values else turned
