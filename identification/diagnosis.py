"""What is wrong with measurements that no robot near its drawing could have made, and what a refused fit suffers from.

Registered to the nominal robot, residuals are compared with what the tolerances can do. Where they are far larger the
usual mistakes are tried, one at a time: a wrong unit, another order of a quaternion, swapped columns, a turned sign.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, Parameters
from kincal.identification.estimators import Estimate, register, registration_of
from kincal.identification.identification import HUMAN
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes import ROWS, TRANSFORMS
from kincal.identification.mistakes.mistake import Kind, Mistake
from kincal.identification.mistakes.registered import registered as registered_quickly
from kincal.identification.mistakes.registered import tool_poses
from kincal.identification.registration import MIN_POSES
from kincal.identification.shrinkage import N_FRAMES, Linear, standardise
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import Motion, log

_EXCESS = 25.0  # mean square of residuals over what tolerances and noise explain: beyond, a mistake is looked for
_BETTER = 10.0  # a mistake explains the residuals if they are so much smaller without it
_ALIKE = 2.0  # mistakes whose residuals are within this factor explain them alike
_LONGEST = 300  # poses, among which wrong rows are looked for
_CLEAN = 1.5  # excess of a table without a mistake: less is as good
_SOME, _CLOSER, _WORSE = 24, 8, 30.0  # poses of a quick look, mistakes that are looked at closely, times the least
_LOOK = 60  # poses, and steps of a registration, that are enough to see a mistake
_FEW_STEPS = 6
_NOISE = 3.0  # poses that differ by less than so many sigmas excite nothing
_HARDLY_TOLD = 2.0  # tolerances of one sigma
FLAGGED, REFUSED = 4.0, 12.0  # tolerances that a parameter may have moved by


def registered(model: ErrorModel, measured: Measurements, max_iterations: int) -> Estimate:
    """`register`, after a look at whether the measurements can be those of a robot near its drawing.

    Raises InputError and CalibrationError as `register` does, with the likely cause where there is one, and InputError
    for poses that excite nothing and for residuals that a mistake in the measurements explains.
    """
    _check_spread(model, measured)
    few = measured[np.linspace(0, len(measured) - 1, min(len(measured), _LOOK)).astype(int)]
    excess = _excess(model, few)
    cause = likely_cause(model, measured, few, excess) if excess > _EXCESS else ""
    if cause and np.isfinite(excess):
        raise InputError(
            f"measurements: registered to the nominal robot they are off by {np.sqrt(excess):.3g} times what "
            f"[tolerance] and [sensor] explain; likely cause: {cause}"
        )
    try:
        return register(model, measured, max_iterations)
    except (InputError, CalibrationError) as error:
        raise type(error)(f"{error}{cause and '; likely cause: ' + cause}") from None


def likely_cause(model: ErrorModel, whole: Measurements, measured: Measurements, excess: float) -> str:
    """The mistakes without which the residuals are much smaller, where several explain them alike; else nothing.

    whole: all poses; measured: as many of them as show a mistake of all rows.
    """
    limit = max(min(excess / _BETTER, _EXCESS), _CLEAN)
    some = measured[np.linspace(0, len(measured) - 1, min(len(measured), _SOME)).astype(int)]
    rows = whole[:_LONGEST]
    likely = [(mistake, measured) for mistake in _likeliest(TRANSFORMS, model, measured, some)]
    likely += [(mistake, rows) for mistake in _likeliest(ROWS, model, rows, rows)]
    tried = [(_excess(model, data, mistake.undone), mistake) for mistake, data in likely]
    least = min((size for size, _ in tried), default=np.inf)
    if least < limit:
        return _named([mistake for size, mistake in tried if size < _ALIKE * max(least, _CLEAN)])
    for channel in measured.channels:
        others = tuple(c for c in measured.channels if c != channel)
        if any(c.registers for c in named(others)) and _excess(model, measured, lambda m, c=others: m.only(c)) < limit:
            return f"{channel} contradicts {' and '.join(others)}: without it the measurements agree with the drawing"
    return ""


def _likeliest(kinds: Sequence[Kind], model: ErrorModel, data: Measurements, some: Measurements) -> list[Mistake]:
    """The mistakes without which residuals at some poses are smallest, by a quick registration: worth a closer look."""
    sizes: list[tuple[float, int, Mistake]] = []
    tool = _tool_poses(model, some)
    for mistake in (mistake for kind in kinds for mistake in _of_kind(kind, model, data)):
        try:
            data_there = mistake.undone(some)
            same = tool if data_there.readings is some.readings else None
            sizes.append((registered_quickly(model, data_there, same).size, len(sizes), mistake))
        except (InputError, CalibrationError, np.linalg.LinAlgError, ValueError):
            continue
    sizes.sort(key=lambda entry: entry[:2])
    return [mistake for size, _, mistake in sizes[:_CLOSER] if size < _WORSE * sizes[0][0]]


def _tool_poses(model: ErrorModel, measured: Measurements) -> Motion | None:
    try:
        return tool_poses(model, measured.readings)
    except InputError:
        return None


def _named(mistakes: Sequence[Mistake]) -> str:
    """Their causes; several that a symmetry makes one are named once."""
    counts = Counter(mistake.alike for mistake in mistakes if mistake.alike)
    causes = (m.alike if m.alike and counts[m.alike] > 1 else m.cause for m in mistakes)
    return ", or ".join(dict.fromkeys(causes))


def _of_kind(kind: Kind, model: ErrorModel, measured: Measurements) -> list[Mistake]:
    """Its mistakes; none where it can't look for them."""
    try:
        return list(kind(model, measured))
    except (InputError, CalibrationError, np.linalg.LinAlgError):
        return []


def _check_spread(model: ErrorModel, measured: Measurements) -> None:
    """Refuse poses that differ by nothing, or by no more than noise, and a sensor that shows the same everywhere."""
    n = len(measured)
    different = len(np.unique(measured.readings, axis=0))
    if n >= MIN_POSES and different < MIN_POSES:
        count = f"all {n} poses have the same joint values" if different == 1 else f"{n} poses, {different} different"
        raise InputError(
            f"measurements: {count}: they do not excite the parameters; at least {MIN_POSES} different ones are needed"
        )
    closure = model.robot(np.zeros(len(model.parameters))).close(measured.readings)
    if not closure.closed.all():
        return  # registration says which
    turned = _turned(closure.pose.rotation)
    moved = np.linalg.norm(np.ptp(closure.pose.translation, axis=0)) + turned
    spans = {c.name: moved if c.unit == "m" else turned for c in named(measured.channels)}
    if all(span < _NOISE * _sigma(measured, c) for c, span in spans.items()):
        raise InputError(
            f"measurements: the poses differ by {np.rad2deg(turned):.2g} deg and {1e3 * moved:.2g} mm, no more than "
            "the sensors' noise: they do not excite the parameters; measure poses all over the workspace"
        )
    for channel, span in spans.items():
        values = measured.values[channel].reshape(n, -1)
        if span > _NOISE * _sigma(measured, channel) and np.ptp(values, axis=0).max() == 0.0:
            raise InputError(f"measurements: {channel} is the same at every pose, though the robot moves: is it stuck?")


def _sigma(measured: Measurements, channel: str) -> float:
    return float(np.median(measured.std[channel]))


def _turned(rotation: np.ndarray) -> float:
    """The largest angle between the first of n orientations and another [rad]."""
    return float(np.max(np.linalg.norm(log(rotation[0].T @ rotation), axis=1)))


def _excess(model: ErrorModel, measured: Measurements, change: Callable | None = None) -> float:
    """Mean square of registered residuals over the expectation of tolerances and noise; infinite where none exist."""
    try:
        measured = change(measured) if change else measured
        registered = registration_of(model, measured, _FEW_STEPS)
    except (InputError, CalibrationError, np.linalg.LinAlgError):
        return np.inf
    data = standardise(Linear(registered.at.triangle, measured.rows), model.parameters.tolerance[:-N_FRAMES])
    return float(np.sum(registered.at.residual**2) / (measured.rows + np.sum(data.s**2)))


def moved_far(parameters: Parameters, p: np.ndarray, std: np.ndarray) -> tuple[str, ...]:
    """What to say of parameters that moved by more than 4 tolerances; W and T, whose priors are flat, apart.

    std: (n_parameters,) one sigma of each. Raises CalibrationError for more than 12: such an estimate is refused.
    """
    moved = np.abs(p / parameters.tolerance)
    findings = []
    # a zero and a placement along the same axis can't be told apart: of equals the one that is set most easily
    equal = np.round(moved, 3)
    order = sorted(range(len(p)), key=lambda j: (-equal[j], not parameters.names[j].endswith(".zero")))
    for j in (j for j in order if moved[j] > FLAGGED):
        unit, factor = HUMAN[parameters.units[j]]
        size = f"{parameters.names[j]} moved by {moved[j]:.1f} tolerances ({p[j] * factor:+.4g} {unit})"
        uncertain = std[j] / parameters.tolerance[j]
        if uncertain > _HARDLY_TOLD:  # an estimator without priors
            cause = f"the measurements determine it to {uncertain:.1f} tolerances only; "
            cause += "estimator = 'map' uses the tolerances"
        else:
            cause = _cause(parameters.names[j], parameters.units[j])
        findings.append(f"{size}: {cause}")
    if findings and moved.max() > REFUSED:
        raise CalibrationError(f"identification is refused: {findings[0]}; allowed are {REFUSED:g} tolerances")
    return tuple(findings)


def _cause(name: str, unit: str) -> str:
    joint, _, part = name.rpartition(".")
    if part == "zero":
        return f"check whether it was homed where actuator.{joint}.zero says"
    if part == "gain":
        return f"check actuator.{joint}.gain and the unit of the readings"
    key = "position_mm" if unit == "m" else "rotation_deg"
    return f"check its place in the drawing, and whether tolerance.{key} is too small"
