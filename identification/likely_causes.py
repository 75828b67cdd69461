"""Which mistakes explain measurements that no robot near its drawing could have made.

A mistake is judged by the misfit that is left without it (`LinearRobot.misfit`): 1 for a robot within its tolerances.
All kinds are tried at a few poses; the likeliest are looked at closely. Every mistake that explains the measurements
about as well as the best one is named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes import ROWS, TRANSFORMS, VALUES
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.mistake import CONTRADICTION, Kind, Mistake
from kincal.identification.mistakes.parts import parts_that_are_off
from kincal.identification.mistakes.registered import Registered, drawn_closure, registered
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.kinematics import Closure

BETTER = 4.0  # a mistake is named if the misfit is so many times smaller without it
_EXPLAINED = 50.0  # the largest misfit that may be left: geometry explains not all of a clean table either
_CLEAN = 1.5  # misfit of a table without a mistake: less is as good
_ALIKE = 2.0  # mistakes whose misfits are within this factor explain the measurements alike
_TELLING = 4.0  # times the misfit that is left without a whole channel: any other mistake says more
_SHARE = 0.5  # of what the best explains, the least of one that is alike
_SAME = 1.01  # times the least misfit: the same
_MANY = 3  # times as many poses as another mistake leaves out: it says nothing of those
_SOME, _LOOK = 24, 60  # poses of a quick look, and of a close one
_CLOSER = 16  # mistakes that are looked at closely
_WORSE, _ABSURD = 30.0, 100.0  # times the least misfit, and the least size: worth no look
_SURPRISE = 1.5  # times what is foreseen, the misfit may be better
_LONGEST = 300  # poses, among which wrong rows are looked for

_FAILED = (InputError, CalibrationError, np.linalg.LinAlgError, ValueError)


@dataclass(frozen=True)
class Causes:
    """The mistakes that explain the measurements, the likeliest first."""

    mistakes: tuple[Mistake, ...]
    misfit: float  # without the likeliest
    symmetric: bool = False  # whether all explain the measurements equally well

    @property
    def wrong(self) -> tuple[int, ...]:
        """The poses without which all is well, where a cause says so of some."""
        return self.mistakes[0].wrong

    @property
    def lasting(self) -> bool:
        """Whether a fit tells of the likeliest, so that nothing need be refused."""
        return self.mistakes[0].lasting

    def __str__(self) -> str:
        """Causes; several that a symmetry makes one are named once."""
        counts = Counter(mistake.alike for mistake in self.mistakes if mistake.alike)
        words = (m.alike if m.alike and counts[m.alike] > 1 else m.cause for m in self.mistakes)
        different = list(dict.fromkeys(words))
        alike = " (a symmetry makes these alike)" if self.symmetric and len(different) > 1 else ""
        return ", or ".join(different) + alike


def misfit(model: ErrorModel, measured: Measurements) -> float:
    """Of measurements as they are, at no more than 60 poses; infinite where the loops do not close."""
    some = _spread(measured, _LOOK)
    try:
        return LinearRobot.of(model, some).misfit_nearby(model, some)
    except _FAILED:
        return np.inf


def likely_causes(model: ErrorModel, measured: Measurements, now: float, better: float = BETTER) -> Causes | None:
    """The mistakes without which the misfit, `now`, is several times smaller; None where there is none."""
    some, rows, look = _spread(measured, _SOME), measured[:_LONGEST], _spread(measured, _LOOK)
    likely = [(mistake, look) for mistake in _likeliest(_all(TRANSFORMS, model, some), model, some)]
    likely += [(mistake, rows) for mistake in _all(ROWS, model, rows)]
    likely += [(mistake, look) for mistake in _contradictions(measured)]
    return _best([(_without(model, mistake, data), mistake) for mistake, data in likely], now, better)


def causes_of_small(model: ErrorModel, measured: Measurements, now: float, better: float) -> Causes | None:
    """As `likely_causes`, several times faster, where the misfit is small.

    Mistakes that small are not all: of values that are nearly what they should be, and parts that are a little off.
    """
    some, rows, look = _spread(measured, _SOME), measured[:_LONGEST], _spread(measured, _LOOK)
    try:
        robot = LinearRobot.of(model, some)
    except _FAILED:
        return None
    off = _all((parts_that_are_off,), model, rows)
    likely = [(mistake, rows) for mistake in off if mistake.foreseen * better < _SURPRISE * now]
    for mistake in _all(VALUES, model, some):
        residual = pose_residual(
            robot.predicted, mistake.undone(some)
        )  # the derivatives are those of what was predicted
        if replace(robot, residual=residual).misfit * better < now:
            likely.append((mistake, look))
    return _best([(_without(model, mistake, data), mistake) for mistake, data in likely], now, better)


def _best(tried: Sequence[tuple[float, Mistake]], now: float, better: float) -> Causes | None:
    """Those that explain about as much as the best; tried: with the misfits that are left."""
    least = min((size for size, _ in tried), default=np.inf)
    telling = [
        entry for entry in tried if entry[1].general < CONTRADICTION and entry[0] <= _TELLING * max(least, _CLEAN)
    ]
    tried = telling or tried
    least = min((size for size, _ in tried), default=np.inf)
    if not least * better <= now or least > _EXPLAINED:
        return None
    most = min(_ALIKE * max(least, _CLEAN), now - _SHARE * (now - least) if np.isfinite(now) else np.inf)
    alike = sorted((entry for entry in tried if entry[0] <= most), key=lambda entry: entry[0])
    level = min(mistake.general for _, mistake in alike)
    fewest = min((mistake.rows for _, mistake in alike if mistake.rows), default=0)
    named = [(s, m) for s, m in alike if m.general == level and m.rows <= _MANY * fewest] or alike[:1]
    return Causes(tuple(m for _, m in named), least, all(s < _SAME * named[0][0] for s, _ in named))


def _spread(measured: Measurements, most: int) -> Measurements:
    return measured[np.unique(np.linspace(0, len(measured) - 1, min(len(measured), most)).astype(int))]


def _all(kinds: Sequence[Kind], model: ErrorModel, measured: Measurements) -> list[Mistake]:
    """Of all kinds; none of a kind that can't look for its own here."""
    mistakes: list[Mistake] = []
    for kind in kinds:
        try:
            mistakes += kind(model, measured)
        except _FAILED:
            continue
    return mistakes


def _likeliest(mistakes: Sequence[Mistake], model: ErrorModel, some: Measurements) -> list[Mistake]:
    """Those with the least misfit at some poses."""
    closure = _closure(model, some)
    registrations: list[tuple[Registered, Measurements, Mistake]] = []
    for mistake in mistakes:
        try:
            data = mistake.undone(some)
            known = closure if data.readings is some.readings else None
            registrations.append((registered(model, data, known), data, mistake))
        except _FAILED:
            continue
    least = min((at.size for at, _, _ in registrations), default=np.inf)
    sizes = [
        (_misfit(model, data, at), k, mistake)
        for k, (at, data, mistake) in enumerate(registrations)
        if at.size < _ABSURD * least
    ]
    sizes.sort(key=lambda entry: entry[:2])
    return [mistake for size, _, mistake in sizes[:_CLOSER] if size < _WORSE * max(sizes[0][0], _CLEAN)]


def _closure(model: ErrorModel, measured: Measurements) -> Closure | None:
    try:
        return drawn_closure(model, measured.readings)
    except InputError:
        return None


def _misfit(model: ErrorModel, measured: Measurements, at: Registered) -> float:
    try:
        return LinearRobot.of(model, measured, at).misfit
    except _FAILED:
        return np.inf


def _without(model: ErrorModel, mistake: Mistake, measured: Measurements) -> float:
    try:
        return LinearRobot.of(model, mistake.undone(measured)).misfit
    except _FAILED:
        return np.inf


def _contradictions(measured: Measurements) -> list[Mistake]:
    """A channel without which the others agree with the drawing: all that is left to say where nothing else fits."""
    mistakes = []
    for channel in measured.channels:
        others = tuple(c for c in measured.channels if c != channel)
        if any(c.registers for c in named(others)):
            cause = f"{channel} contradicts {' and '.join(others)}: without it the measurements agree with the drawing"
            mistakes.append(Mistake(cause, lambda m, others=others: m.only(others), general=CONTRADICTION))
    return mistakes
