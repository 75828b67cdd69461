"""Measurements that no robot near its drawing could have made are refused; what a refused fit suffers from."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, Parameters
from kincal.identification.identification import HUMAN
from kincal.identification.likely_causes import BETTER, Causes, causes_of_small, likely_causes, misfit
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import FRAMES, LinearRobot
from kincal.identification.mistakes.parts import DRIFT
from kincal.identification.registration import MIN_POSES
from kincal.urdf.errors import CalibrationError, InputError, MovedFarError
from kincal.urdf.rigid_motion import log

_MISFIT = 16.0  # beyond, a mistake is looked for: four times what tolerances and sigmas allow
_FLAGGED_BETTER = 1.5  # a mistake explains parameters that moved far if the misfit is so many times smaller without it
_TOO_SMALL, _AT_ONCE = 2.0, 300  # times: sigmas that are worth a word; poses that tell it
_SMALL_MISFIT, _SMALL_BETTER = 2.5, 2.0  # and large residuals, where the misfit is larger than that
_MANY = 0.1  # of the poses
_CLOSED = 1e-9  # [m, rad] of loops that close, though not on home's branch
_NOISE = 3.0  # poses that differ by less than so many sigmas excite nothing
_HARDLY_TOLD = 2.0  # tolerances of one sigma
FLAGGED, REFUSED = 4.0, 12.0  # tolerances that a parameter may have moved by


@dataclass(frozen=True)
class Screening:
    """Which poses may be fitted."""

    kept: np.ndarray  # (n,) bool
    causes: str  # of the others
    misfit: float  # of those that may be

    @property
    def finding(self) -> str:
        n = int(np.sum(~self.kept))
        many = "; identify.loss = 'huber' would keep them, with less weight" if n > _MANY * len(self.kept) else ""
        return f"{n} of {len(self.kept)} poses are left out: {self.causes}{many}" if n else ""


def screened(model: ErrorModel, measured: Measurements, reject_outliers: bool = True) -> Screening:
    """Looks at whether the measurements can be those of a robot near its drawing, before they are fitted.

    Poses that do not fit the others are left out. Raises InputError for poses that excite nothing, for loops that can't
    be closed, and for whatever a mistake in the measurements explains, with its cause.
    """
    _check_spread(model, measured)
    size = misfit(model, measured)
    everything = np.ones(len(measured), dtype=bool)
    if size <= _MISFIT:
        return Screening(everything, "", size)
    copies = copied_columns(measured)
    if copies:
        raise InputError(f"measurements: {_far(size)}; likely cause: {copies}")
    causes = likely_causes(model, measured, size)
    if causes is not None and causes.wrong and reject_outliers:
        return Screening(~np.isin(measured.pose, causes.wrong), str(causes), causes.misfit)
    if np.isinf(size):
        _check_closed(model, measured, causes)
    if causes is None or causes.lasting:
        return Screening(everything, "", size)
    cure = "; measure.skip leaves poses out, and so does identify.reject_outliers = true" if causes.wrong else ""
    raise InputError(f"measurements: {_far(size)}; likely cause: {causes}{cure}")


def _far(size: float) -> str:
    if not np.isfinite(size):
        return "no robot near the drawing can have made them"
    return f"{np.sqrt(size):.3g} times farther from the drawing than [tolerance] and [sensor] explain"


def copied_columns(measured: Measurements) -> str:
    """Which measured column repeats another bit for bit, in words; empty: none does."""
    columns = {}
    for channel in named(measured.channels):
        columns |= channel.write(measured.values[channel.name])
    for (first, values), (second, others) in combinations(columns.items(), 2):
        if np.ptp(values) > 0 and np.array_equal(values, others):
            return f"the columns {first} and {second} hold the same values at every pose: one is a copy"
    return ""


def explained(model: ErrorModel, measured: Measurements, error: CalibrationError) -> CalibrationError:
    """A failed fit with its likely cause, where one is known; a parameter that moved far is then not to blame."""
    moved = isinstance(error, MovedFarError)
    causes = likely_causes(model, measured, misfit(model, measured), _FLAGGED_BETTER if moved else BETTER)
    cause = str(causes) if causes is not None else too_small_sigmas(model, measured) if moved else ""
    if cause:
        error.args = (f"{error.reason if moved else error}; likely cause: {cause}",)
    return error


def too_small_sigmas(model: ErrorModel, measured: Measurements) -> str:
    """In words, where with larger sigmas the residuals fit them and no parameter moves far; empty: not so."""
    robot = LinearRobot.of(model, measured[:_AT_ONCE])
    factor = robot.sigmas_that_fit()
    if factor < _TOO_SMALL:
        return ""
    _, step = robot.with_sigmas(factor).solved()
    if np.max(np.abs(step[:-FRAMES])) > FLAGGED:
        return ""
    times = f"{float(f'{factor:.2g}'):g} times larger no parameter moves by {FLAGGED:g} tolerances"
    return f"the sigmas of [sensor] are too small: {times}"


def cause_of_misfit(model: ErrorModel, measured: Measurements, p: np.ndarray, size: float) -> str:
    """The likely cause of parameters that moved by more than 4 tolerances, or of large residuals; empty: none is known.

    p: the parameters that were identified; size: the misfit of the drawing.
    """
    if np.max(np.abs(p / model.parameters.tolerance)) > FLAGGED:
        causes, what = likely_causes(model, measured, size, _FLAGGED_BETTER), "parameters moved far"
    else:
        small = size > _SMALL_MISFIT
        causes = causes_of_small(model, measured, size, _SMALL_BETTER) if small else None
        what = "residuals are large"
    # of a drift, `drift_finding` tells
    if causes is None or str(causes).startswith(DRIFT):
        return ""
    return f"{what}; likely cause: {causes}; 95 % regions do not know of it, and can't be trusted"


def _check_closed(model: ErrorModel, measured: Measurements, causes: Causes | None) -> None:
    """InputError where the loops of the robot as drawn can't be closed at some readings."""
    closure = model.robot(np.zeros(len(model.parameters))).close(measured.readings)
    n = int(np.sum(~closure.closed))
    if n == 0:
        return
    row = int(np.argmin(closure.closed))
    gap = closure.residual[row]
    where = (
        f"worst by {gap:.3g} m or rad at pose {measured.pose[row]}"
        if gap > _CLOSED
        else f"only on another branch than home's, or beyond joint limits, at pose {measured.pose[row]}"
    )
    tested = "a sign, a zero, a scale or a unit of one joint, swapped joints"
    cause = (
        f"likely cause: {causes}"
        if causes is not None
        else f"none of these explains it: {tested}. Correct the drawing or actuator.*.zero"
    )
    raise InputError(
        f"measurements: the loops of the drawing can't be closed at {n} of {len(measured)} poses ({where}); {cause}"
    )


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
        reason = f"identification is refused: {findings[0].partition(': ')[0]}; allowed are {REFUSED:g} tolerances"
        raise MovedFarError(f"identification is refused: {findings[0]}; allowed are {REFUSED:g} tolerances", reason)
    return tuple(findings)


def _cause(name: str, unit: str) -> str:
    joint, _, part = name.rpartition(".")
    if part == "zero":
        return f"check whether it was homed where actuator.{joint}.zero says"
    if part == "gain":
        return f"check actuator.{joint}.gain and the unit of the readings"
    key = "position_mm" if unit == "m" else "rotation_deg"
    return f"check its place in the drawing, and whether tolerance.{key} is too small"
