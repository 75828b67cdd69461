"""What calibration must reach on a simulated 3-UPS/S robot: 150 poses, five robots.

Scored here independently of the stage `evaluate`, on random poses of the workspace against the noise-free truth.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.pipeline.virtual.robot import VirtualRobot
from kincal.urdf.kinematics import inverse
from kincal.urdf.workspace import sample

SEEDS = range(5)
GEOMETRIC_ALONE = ("measure.errors.elastic=false", "measure.errors.screw=false")


@dataclass(frozen=True)
class Mean:
    """Mean orientation errors [deg] of one robot."""

    raw: float  # as drawn, W = T = 1
    nominal: float  # as drawn, W and T fitted
    geometric: float


def scored(run) -> Mean:
    model, measured, identified = run.until("model", "measure", "identify")
    description = run.robot.description
    errors = ErrorModel.of(model.chain(), description.actuator, description.tolerance)
    chain = errors.chain
    closure = inverse(chain, sample(description.workspace, chain.tool_axes, 500, [description.seed, 99]))
    readings = errors.actuators.readings(closure.q[:, chain.actuated])
    truth = Rotation.from_matrix(VirtualRobot.of(errors, measured.truth).pose(readings).rotation)

    def mean(p: np.ndarray) -> float:
        robot = errors.robot(p)
        predicted = robot.measured(robot.close(readings).pose)
        return float(np.rad2deg((truth.inv() * Rotation.from_matrix(predicted.rotation)).magnitude()).mean())

    return Mean(mean(np.zeros(len(errors.parameters))), mean(identified.registered), mean(identified.shipped.change))


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return tmp_path_factory.mktemp("targets") / "store"


@pytest.fixture(scope="module", params=[(), GEOMETRIC_ALONE], ids=["all errors", "geometric alone"])
def robots(request, start, store) -> tuple[float, list[Mean]]:
    """The target [deg], and what five robots reach."""
    runs = [start(store, f"seed={seed}", "plan.poses=150", *request.param)[0] for seed in SEEDS]
    return (0.0005 if request.param else 0.004), [scored(run) for run in runs]


def test_geometric_reaches_its_target(robots):
    """0.004 deg where legs give under 40 kg and screws have errors, 0.0005 deg without these."""
    target, found = robots
    assert np.median([mean.geometric for mean in found]) <= target


def test_nominal_registered_and_raw(robots):
    """What the drawing is worth: with W and T fitted some tenths of a degree, with neither more than one."""
    _, found = robots
    for mean in found:
        assert 0.01 < mean.nominal < 0.5
        assert mean.nominal < mean.raw < 5.0
    assert np.median([mean.raw for mean in found]) > 1.0


def test_evaluate_says_the_same(finished, start):
    """The stage's own score of geometric, on poses of its own."""
    mean = scored(start(finished.store, *finished.settings)[0])
    assert finished.comparison.scored_on == "fresh"
    assert finished.comparison.n_scored >= 500
    assert finished.comparison.methods[1].mean_deg == pytest.approx(mean.geometric, rel=0.1)
    assert finished.comparison.methods[0].mean_deg == pytest.approx(mean.nominal, rel=0.1)
    assert finished.comparison.raw_nominal.mean_deg == pytest.approx(mean.raw, rel=0.1)


def test_tilt_alone_says_nothing_of_z(start, store):
    run, _ = start(store, "plan.poses=40", 'measure.channels=["tilt"]')
    found = run.until("evaluate")[0]
    for method in (*found.methods, *found.held_out, found.raw_nominal):
        assert method.axis_mean_deg["z"] is None
        assert method.mean_mm is method.max_mm is method.sd_mm is None
        assert method.mean_deg > 0
    nominal, geometric = found.methods[:2]
    assert geometric.mean_deg < 0.5 * nominal.mean_deg
