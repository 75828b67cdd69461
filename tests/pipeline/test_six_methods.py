"""The six methods of whole runs of ups3_s: what the table promises, scored on fresh poses without noise."""

import numpy as np
import pytest

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.run.runner import Run
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError

SMALL = (
    *("pretrain.iterations=20", "transfer.iterations=30", "prior.poses=125"),
    *("siblings.count=16", "siblings.poses=150", "siblings.hidden=12", "siblings.iterations=300"),
)
GEOMETRIC_ALONE = ("measure.errors.elastic=false", "measure.errors.screw=false")
OPEN_LOOP = ("evaluate.closed_loop=false",)
TILT_ALONE = ('measure.channels=["tilt"]',)


@pytest.fixture(scope="session")
def compared(tmp_path_factory):
    """compared(*overrides): the comparison that ends a run (or another stage's result), in a store of these tests."""
    store = tmp_path_factory.mktemp("six_methods") / "store"

    def compared(*overrides: str, stage: str = "evaluate"):
        return Run(load_robot("ups3_s", overrides), Store(store)).until(stage)[0]

    return compared


def by_name(rows) -> dict:
    return {row.name: row for row in rows}


@pytest.fixture(scope="session")
def default(compared):
    """The default run: 150 poses, streams, elastic legs and screw errors."""
    return compared()


def test_six_rows_in_the_tables_order(default):
    """By the issue: before, the model, the paper's two networks, a third on the identified model, and the hybrid."""
    order = ["nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid"]
    assert list(METHODS) == order
    for rows in (default.methods, default.held_out, default.closed_loop):
        assert [row.name for row in rows] == order
    assert (default.n_poses, default.scored_on, default.channels) == (150, "fresh", ("tilt", "yaw"))
    assert default.n_scored >= 500


def test_targets(default):
    """Figures of the issue, mean degrees; the paper has 0.015 for its transfer network."""
    found = {name: row.mean_deg for name, row in by_name(default.methods).items()}
    assert found["transfer"] <= 0.015
    assert found["geometric"] <= 0.004
    assert found["hybrid"] <= 0.0007  # the 0.0006 is a median over ten seeds
    assert by_name(default.methods)["hybrid"].max_deg <= 0.003
    assert found["hybrid"] < found["geometric"] / 3
    assert found["transfer"] < found["network"]
    assert found["network"] < found["nominal"]


def test_targets_hold_on_held_out_measurements(default):
    """On the fifth of the poses that these fits have not seen, against noisy measurements: the order stays."""
    found = {name: row.mean_deg for name, row in by_name(default.held_out).items()}
    assert found["hybrid"] <= 0.002
    assert found["hybrid"] < found["geometric"] < found["nominal"]


def test_closed_loop(default):
    """Where the virtual robot is, against where it should be: compensation costs next to nothing."""
    predicted, reached = by_name(default.methods), by_name(default.closed_loop)
    assert reached["hybrid"].mean_deg <= 1.3 * predicted["hybrid"].mean_deg
    assert reached["hybrid"].mean_deg < 0.02 * reached["nominal"].mean_deg
    for name in METHODS:
        assert reached[name].mean_deg == pytest.approx(predicted[name].mean_deg, rel=0.3)


def test_rows_are_consistent(default):
    """Axis means, mean and maximum of one error vector bound each other; a robot that only turns has no millimetres."""
    for row in (*default.methods, *default.held_out, *default.closed_loop):
        axes = np.array([row.axis_mean_deg[a] for a in "xyz"])
        assert axes.max() <= row.mean_deg <= axes.sum()
        assert row.mean_deg + 0.5 * row.sd_deg <= row.max_deg
        assert row.mean_mm is row.max_mm is row.sd_mm is None


@pytest.mark.parametrize("seed", range(2))
def test_hybrid_costs_nothing_where_geometry_explains_all(compared, seed):
    """No elastic legs, no screw errors: what is left to learn is noise, and evidence must say so."""
    found = by_name(compared("plan.poses=40", f"seed={seed}", *GEOMETRIC_ALONE, *SMALL, *OPEN_LOOP).methods)
    assert found["hybrid"].mean_deg <= 1.3 * found["geometric"].mean_deg
    assert found["geometric"].mean_deg < 0.002


@pytest.mark.parametrize("seed", range(2))
def test_hybrid_with_ten_poses(compared, seed):
    """Too few to learn from: not worse than the model alone."""
    found = by_name(compared("plan.poses=10", f"seed={seed}", *SMALL, *OPEN_LOOP).methods)
    assert found["hybrid"].mean_deg <= 1.2 * found["geometric"].mean_deg
    assert found["hybrid"].mean_deg < found["nominal"].mean_deg


def test_tilt_alone(compared):
    """All rows exist, scored on the vertical; about it nothing is known and nothing is said."""
    found = compared("plan.poses=40", *TILT_ALONE, *SMALL)
    assert found.channels == ("tilt",)
    for rows in (found.methods, found.held_out, found.closed_loop):
        assert [row.name for row in rows] == list(METHODS)
        for row in rows:
            assert row.axis_mean_deg["z"] is None
            assert row.axis_mean_deg["x"] > 0
            assert row.axis_mean_deg["y"] > 0
            assert 0 < row.mean_deg <= row.max_deg
            assert row.mean_mm is None
    scores = by_name(found.methods)
    assert scores["geometric"].mean_deg < 0.5 * scores["nominal"].mean_deg
    assert scores["hybrid"].mean_deg <= 1.2 * scores["geometric"].mean_deg


def test_a_network_larger_than_the_data_allows(compared):
    """64 hidden units have 4611 weights, ten poses 30 values: refused by the setting's name, found and allowed."""
    with pytest.raises(InputError) as error:
        compared("plan.poses=10", "pretrain.hidden=64", *SMALL)
    said = str(error.value)
    assert "pretrain.hidden" in said
    assert "64" in said
    assert "10 poses" in said
    assert "allowed is" in said
    assert "\n" not in said


def test_the_largest_network_that_is_allowed_runs(compared):
    """What the refusal names as allowed is accepted, one more is not."""
    with pytest.raises(InputError) as error:
        compared("plan.poses=10", "pretrain.hidden=64", *SMALL)
    largest = int(str(error.value).rsplit(" ", 1)[1])
    few = ("plan.poses=10", "prior.poses=8", "pretrain.iterations=1", "pretrain.continued=1")
    accepted = compared(f"pretrain.hidden={largest}", *few, stage="pretrain")
    assert accepted.start.sizes == (3, largest, largest, 3)
    with pytest.raises(InputError, match=rf"pretrain\.hidden = {largest + 1}"):
        compared(f"pretrain.hidden={largest + 1}", *few, stage="pretrain")
