"""The recommendation at the end of a comparison: which method, its expected error, and what more poses would bring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kincal.identification.channels import scored
from kincal.identification.coverage import NOT_COVERED
from kincal.identification.predicted_accuracy import mean_length
from kincal.pipeline.methods.calibrated import SURE, Calibrated
from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.results import Advice, MethodScore

_GAIN = 0.2  # share of the expected error that makes more poses worth while
_AS_GOOD = 1.02  # of two methods so near each other the simpler one is taken
_STEEPEST = 1.0  # fall of the error with the number of poses, as a power: noise alone gives 1/2
_LARGEST = 4.0  # times the poses: farther nothing is foretold


def advise(
    calibrated: Calibrated, scores: Sequence[MethodScore], readings: np.ndarray, findings: Sequence[str]
) -> Advice:
    """Of scored methods; expected errors are those of poses like the measured ones, at readings (n, n_actuated).

    findings: of the identification, which the advice does not contradict.
    """
    best, corrected = _best(scores), calibrated.corrected
    assert corrected is not None
    expected = _expected(calibrated, best, readings)
    if expected is None:
        score = next(s for s in scores if s.name == best)
        expected = (score.mean_deg, score.mean_mm)
    n, more, saved = len(readings), None, 1.0
    power = _power(corrected.learning_curve, best)
    if power > 0:
        factor = (1 - _GAIN) ** (-1 / power)
        if factor <= _LARGEST:
            more = int(np.ceil(factor * n / 10) * 10)
            saved = (n / more) ** power
    later = tuple(None if e is None or more is None else saved * e for e in expected)
    covered = not any(NOT_COVERED in finding for finding in findings)
    sentences = [
        f"Recommended{'' if covered else ' at poses like the measured ones, not all over [workspace]'}: {best}.",
        f"Expected mean error at poses like the measured ones: {_size(*expected)}.",
    ]
    if more is not None:
        sentences.append(f"With {more - n} more poses ({more}): about {_size(*later)}.")
    elif power > 0 or not len(corrected.learning_curve):
        few = f"{n} poses are too few to estimate the gain from more poses."
        sentences.append(few if n < 30 else "More poses bring little.")
    else:
        sentences.append("More poses bring nothing: the remaining error does not fall with their number.")
    if corrected.correction.shrinkage == 0:
        unexplained = any("can't explain" in finding for finding in findings)
        sentences.append(
            "Neither geometry nor the learned correction explains the measurements: read the findings."
            if unexplained
            else "The learned correction is not used: cross-validation shows no gain."
        )
    return Advice(best, expected[0], expected[1], n, more, later[0], later[1], " ".join(sentences))


def _best(scores: Sequence[MethodScore]) -> str:
    """The least mean error, of what was measured first; the table's order goes from simple to not."""
    key = "mean_deg" if scores[0].mean_deg is not None else "mean_mm"
    values = {s.name: float(getattr(s, key)) for s in scores}
    least = min(values.values())
    return min((name for name, v in values.items() if v <= _AS_GOOD * least), key=METHODS.index)


def _expected(calibrated: Calibrated, best: str, readings: np.ndarray) -> tuple[float | None, float | None] | None:
    """Mean errors [deg], [mm] by the calibrated covariance; None where there is none."""
    covariance, channels = calibrated.covariance(best, readings), calibrated.channels
    if covariance is None:
        return None
    rotation = calibrated.methods[best].predict(readings).rotation
    mean = {
        unit: channel.human[1] * float(np.mean(mean_length(channel.covariance(covariance, rotation))))
        for unit, channel in scored(channels).items()
    }
    return mean.get("rad"), mean.get("m")


def _power(curve: np.ndarray, method: str) -> float:
    """b of an error that falls as n^-b, by a line through the learning curve's logarithms; 0 where nothing is told."""
    errors = curve[:, 1 if method == "geometric" else 2] if len(curve) else np.zeros(0)
    if len(errors) < 3 or not np.all(errors > 0) or method not in SURE:
        return 0.0
    slope = np.polyfit(np.log(curve[:, 0]), np.log(errors), 1)[0]
    return float(np.clip(-slope, 0.0, _STEEPEST))


def _size(deg: float | None, mm: float | None) -> str:
    parts = [f"{value:.2g} {unit}" for value, unit in ((deg, "deg"), (mm, "mm")) if value is not None]
    return " and ".join(parts)
