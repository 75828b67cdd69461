"""The sentence at the end of a comparison: its method, its numbers and its words, on learning curves made up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kincal.pipeline.learned import Corrected
from kincal.pipeline.methods.advice import advise
from kincal.pipeline.methods.calibrated import Calibrated
from kincal.pipeline.results import MethodScore


def score(name: str, deg: float | None, mm: float | None = None) -> MethodScore:
    return MethodScore(name, deg, deg, deg, {}, mm, mm, mm)


def curve(n: int, geometric: float, hybrid: float, power: tuple[float, float]) -> np.ndarray:
    """Errors that fall as powers of the number of poses, to these at all n."""
    sizes = np.round(n * np.array([0.4, 0.55, 0.7, 0.85]))
    return np.stack([sizes, *(e * (sizes / n) ** -b for e, b in zip((geometric, hybrid), power, strict=True))], axis=1)


@pytest.fixture
def advice(robot, correction):
    """advice(scores, curve, n, shrinkage): of methods that have no covariance, so that scores are what is expected."""

    def advice(scores, learning_curve, n=100, shrinkage=1.0, findings=()):
        own = replace(correction(robot("ups3_s"), 1e-4), shrinkage=shrinkage)
        corrected = Corrected(np.zeros(0), own, learning_curve)
        calibrated = SimpleNamespace(corrected=corrected, channels=("orientation",), covariance=lambda *_: None)
        return advise(calibrated, scores, np.zeros((n, 3)), findings)

    return advice


SCORES = [score("nominal", 0.2), score("geometric", 0.004), score("transfer", 0.01), score("hybrid", 0.001)]


@pytest.mark.parametrize("power, more", [(0.5, 160), (1.0, 130), (0.3, 220)])
def test_more_poses_pay(advice, power, more):
    """A fifth less needs (5/4)^(1/power) times the poses, in tens; the error there is by the same power."""
    found = advice(SCORES, curve(100, 5.0, 1.0, (0.1, power)))
    assert (found.method, found.n_poses, found.n_more) == ("hybrid", 100, more)
    assert (found.expected_deg, found.expected_mm) == (0.001, None)
    assert found.expected_more_deg == pytest.approx(0.001 * (100 / more) ** power, rel=1e-9)
    assert found.expected_more_deg <= 0.8 * 0.001
    assert found.text.startswith(
        "Recommended: hybrid. Expected mean error at poses like the measured ones: 0.001 deg. With "
    )
    assert f"With {more - 100} more poses ({more}): about " in found.text


def test_a_curve_steeper_than_chance_allows(advice):
    """Of power 3: counts as 1."""
    assert advice(SCORES, curve(100, 5.0, 1.0, (0.1, 3.0))).n_more == 130


@pytest.mark.parametrize("power, words", [(0.1, "bring little"), (0.0, "bring nothing"), (-0.5, "bring nothing")])
def test_more_poses_do_not_pay(advice, power, words):
    found = advice(SCORES, curve(100, 5.0, 1.0, (0.9, power)))
    assert (found.n_more, found.expected_more_deg, found.expected_more_mm) == (None, None, None)
    assert words in found.text


def test_the_curve_is_that_of_the_method(advice):
    """Geometric wins here, and its error has stopped falling; hybrid's has not."""
    scores = [score("nominal", 0.2), score("geometric", 0.001), score("hybrid", 0.001)]
    found = advice(scores, curve(100, 1.0, 1.0, (0.0, 0.5)), shrinkage=0.0)
    assert (found.method, found.n_more) == ("geometric", None)
    assert found.text.endswith("The learned correction is not used: cross-validation shows no gain.")
    unexplained = ("geometry alone can't explain the measurements: residuals are 10 times the sensors' sigmas",)
    found = advice(scores, curve(100, 1.0, 1.0, (0.0, 0.5)), shrinkage=0.0, findings=unexplained)
    assert found.text.endswith(
        "Neither geometry nor the learned correction explains the measurements: read the findings."
    )


def test_so_few_that_nothing_can_be_told(advice):
    found = advice(SCORES, np.zeros((0, 3)), n=10)
    assert found.n_more is None
    assert "10 poses are too few to estimate the gain from more poses." in found.text


def test_a_curve_with_a_zero_tells_nothing(advice):
    """All of the error is noise: no logarithm of zero."""
    assert advice(SCORES, curve(100, 1.0, 0.0, (0.5, 0.5))).n_more is None


@pytest.mark.parametrize("hybrid, best", [(0.00399, "geometric"), (0.0035, "hybrid"), (0.0041, "geometric")])
def test_of_equals_the_simpler_one(advice, hybrid, best):
    """Within two per cent of the least error."""
    scores = [score("geometric", 0.004), score("transfer_identified", 0.004), score("hybrid", hybrid)]
    assert advice(scores, np.zeros((0, 3))).method == best


def test_millimetres(advice):
    """A robot whose position alone was measured is judged by it; with both by the angle."""
    found = advice([score("geometric", None, 0.4), score("hybrid", None, 0.2)], np.zeros((0, 3)))
    assert (found.method, found.expected_deg, found.expected_mm) == ("hybrid", None, 0.2)
    assert "0.2 mm" in found.text
    assert "deg" not in found.text
    both = advice([score("geometric", 0.01, 0.4), score("hybrid", 0.02, 0.2)], np.zeros((0, 3)))
    assert both.method == "geometric"
    assert "0.01 deg and 0.4 mm" in both.text


def test_what_is_expected_comes_true(calibrated):
    """Of hybrid and geometric by their covariance: near the mean error on fresh poses that nobody has seen."""
    case = calibrated("ups3_s", 100, 300)
    readings = case.readings(300, seed=97)
    truth = case.virtual.pose(readings)
    methods = {"geometric": case.geometric, "hybrid": case.hybrid}
    for name, method in methods.items():
        fitted = Calibrated(case.model, case.fit, None, case.corrected, ("orientation",))
        found = advise(fitted, [score(name, 9.0)], readings, ())
        got = method.predict(readings)
        cosine = (np.einsum("nij,nij->n", got.rotation, truth.rotation) - 1) / 2
        measured = np.rad2deg(np.mean(np.sqrt(2 * np.maximum(1 - cosine, 0))))
        assert found.expected_deg == pytest.approx(measured, rel=0.5)
