"""What calibration must reach on a simulated 3-UPS/S robot: 150 poses, five robots."""

import numpy as np
import pytest

from pipeline.results import Comparison

SEEDS = range(5)
GEOMETRIC_ALONE = ("measure.errors.elastic=false", "measure.errors.screw=false")


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return tmp_path_factory.mktemp("targets") / "store"


@pytest.fixture(scope="module")
def compared(start, store):
    """{settings: comparisons of five robots}, each calculated once."""
    found: dict[tuple[str, ...], list[Comparison]] = {}

    def compared(*settings: str) -> list[Comparison]:
        if settings not in found:
            runs = (start(store, f"seed={seed}", "plan.poses=150", *settings)[0] for seed in SEEDS)
            found[settings] = [run.until("evaluate")[0] for run in runs]
        return found[settings]

    return compared


def means(comparisons: list[Comparison], method: str) -> list[float]:
    return [next(m.mean_deg for m in c.methods if m.name == method) for c in comparisons]


def test_with_non_geometric_errors(compared):
    """The legs give under 40 kg and the screws have errors, which geometry can explain in part."""
    assert np.median(means(compared(), "geometric")) <= 0.004


def test_with_geometric_errors_alone(compared):
    assert np.median(means(compared(*GEOMETRIC_ALONE), "geometric")) <= 0.0005


@pytest.mark.parametrize("settings", [(), GEOMETRIC_ALONE], ids=["all errors", "geometric alone"])
def test_nominal_registered_and_raw(compared, settings):
    """What the drawing is worth: with W and T fitted a tenth of a degree, with neither some degrees."""
    for c, registered in zip(compared(*settings), means(compared(*settings), "nominal"), strict=True):
        assert 0.01 < registered < 0.5
        assert registered < c.raw_nominal.mean_deg < 5.0
        assert c.scored_on == "fresh"
        assert c.n_scored >= 500
    assert np.median([c.raw_nominal.mean_deg for c in compared(*settings)]) > 1.0


def test_held_out_measurements_agree_with_the_truth(compared):
    """Measured poses that a fit has not seen: not much worse than fresh ones without noise."""
    for c in compared():
        geometric = next(m for m in c.held_out if m.name == "geometric")
        assert geometric.mean_deg < 0.01


def test_tilt_alone_says_nothing_of_z(start, store):
    run, _ = start(store, "plan.poses=150", 'measure.channels=["tilt"]')
    found = run.until("evaluate")[0]
    for method in (*found.methods, *found.held_out, found.raw_nominal):
        assert method.axis_mean_deg["z"] is None
        assert method.mean_mm is method.max_mm is method.sd_mm is None
        assert method.mean_deg > 0
    nominal, geometric = means([found], "nominal")[0], means([found], "geometric")[0]
    assert geometric < 0.5 * nominal
