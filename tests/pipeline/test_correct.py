"""`hybrid` on virtual robots: it finds what geometry can't explain, and does no harm where there is nothing."""

from dataclasses import replace

import numpy as np
import pytest

from kincal.identification.error_model import ErrorModel
from kincal.urdf.rigid_motion import log

GEOMETRIC = {"elastic": False, "screw": False}


def mean_error(case, method) -> float:
    """Mean rotation [rad] between predictions and the truth, on 300 fresh poses of the inner workspace."""
    readings = case.readings(300, seed=90, inner=0.95)
    got, truth = method.predict(readings), case.virtual.pose(readings)
    return float(np.linalg.norm(log(truth.rotation.swapaxes(1, 2) @ got.rotation), axis=1).mean())


@pytest.mark.parametrize("n", [10, 50])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_harm_where_geometry_explains_all(calibrated, n, seed):
    """Hybrid is geometric to the last bit: predictions, geometry and commands."""
    case = calibrated("ups3_s", n, seed, **GEOMETRIC)
    assert case.corrected.correction.shrinkage == 0.0
    np.testing.assert_array_equal(case.corrected.refined, case.fit.identified)
    readings = case.readings(50, seed=91)
    one, other = case.hybrid.predict(readings), case.geometric.predict(readings)
    np.testing.assert_array_equal(one.rotation, other.rotation)
    np.testing.assert_array_equal(one.translation, other.translation)
    one, other = (case.loaded.command(m, other)[0] for m in (case.hybrid, case.geometric))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seed", [0, 1])
def test_elastic_legs_and_screws(calibrated, seed):
    """60 poses: less than a third of geometric's mean error on fresh poses, without noise."""
    case = calibrated("ups3_s", 60, seed)
    assert mean_error(case, case.hybrid) < mean_error(case, case.geometric) / 3
    assert case.corrected.correction.evidence > 3


def test_outside_of_the_readings_hybrid_is_geometric(calibrated):
    """Measured in the inner half of the workspace alone: beyond, nothing is believed, to the last bit."""
    case = calibrated("ups3_s", 60, 0, inner=0.5)
    readings = case.readings(200, seed=92)
    share = case.corrected.correction.share(readings)
    assert case.corrected.correction.shrinkage > 0.5
    assert (share == 0).sum() > 20
    assert (share > 0).sum() > 20
    got, geometric = case.hybrid.predict(readings), case.geometric.predict(readings)
    np.testing.assert_array_equal(got.rotation[share == 0], geometric.rotation[share == 0])
    assert np.all(np.abs(got.rotation - geometric.rotation).max(axis=(1, 2))[share > 0.5] > 0)


@pytest.mark.parametrize("name, n", [("ups3_s", n) for n in (4, 5, 6, 8)] + [("linear_delta", 4), ("linear_delta", 8)])
def test_a_handful_of_poses(calibrated, name, n):
    """Numbers, and not worse than geometric by more than a fifth."""
    case = calibrated(name, n, 0)
    assert np.isfinite(case.corrected.refined).all()
    assert np.isfinite(case.corrected.learning_curve).all()
    readings = case.readings(50, seed=93)
    pose = case.hybrid.predict(readings)
    assert np.isfinite(pose.rotation).all()
    assert np.isfinite(pose.translation).all()
    if name == "ups3_s":
        assert mean_error(case, case.hybrid) <= 1.2 * mean_error(case, case.geometric)


def test_a_leg_that_never_moves(calibrated):
    """All poses at one length of the second leg: numbers there, and elsewhere nothing is believed."""
    case = calibrated("ups3_s", 40, 0, still=1)
    readings = case.readings(40, seed=94, still=1)
    assert np.isfinite(case.hybrid.predict(readings).rotation).all()
    assert np.isfinite(case.corrected.correction(readings)).all()
    moved = readings + np.array([0.0, 0.9, 0.0])
    assert np.all(case.corrected.correction.share(moved) == 0)


def test_sigmas_that_nobody_gave(calibrated):
    """Whitened by what geometry leaves, far more than the tracker's own: the correction is found all the same."""
    case = calibrated("ups3_s", 60, 0)
    known, own = case.correct(case.fit), case.correct(case.fit, wider=4.0)
    assert own.correction.shrinkage > 0.9
    method = replace(case.hybrid, refined=case.model.robot(own.refined), correction=own.correction)
    whole = replace(case.hybrid, refined=case.model.robot(known.refined), correction=known.correction)
    assert mean_error(case, method) < 1.5 * mean_error(case, whole)


def test_the_fit_that_ships_has_a_learning_curve(calibrated):
    case = calibrated("ups3_s", 60, 0)
    curve = case.corrected.learning_curve
    assert list(curve[:, 0]) == [24, 33, 42, 51]
    assert np.all(curve[:, 1:] >= 0)


def test_the_columns_of_the_actuators_zeros(robot, central_difference):
    """Against central differences of the error by the joints themselves, gains of millimetres included."""
    loaded = robot("ups3_s", tuple(f"actuator.leg{k}_slide.gain=0.001" for k in (1, 2, 3)))
    model, p = loaded.model, loaded.random_parameters(3)
    readings = loaded.readings(4, seed=2)
    poses = loaded.measure(p, readings, ("orientation", "position"))
    robot_ = model.robot(p)
    found = model.jacobian(p, poses, robot_.close(readings).q)[:, :, model.zeros]
    first = [name.endswith(".zero") for name in model.parameters.names].index(True)
    zeros = slice(first, first + 3)
    assert [name.split(".")[1] for name in model.parameters.names[zeros]] == ["zero"] * 3

    def error(steps: np.ndarray) -> np.ndarray:
        out = []
        for step in steps:
            moved = p.copy()
            moved[zeros] += step
            built = model.robot(moved)
            out.append(model.residual(built, built.close(readings).q, poses))
        return np.array(out)

    expected = central_difference(error, np.zeros(3), 1e-4)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    assert isinstance(model, ErrorModel)


def test_fits_that_have_not_seen_all_have_no_curve(calibrated):
    """Nobody asks it of them; and poses that are held out are not looked at."""
    case = calibrated("ups3_s", 30, 5)
    test = np.arange(3)
    own = case.correct(replace(case.fit, test=test))
    assert own.learning_curve.shape == (0, 3)
    spoiled = case.correct(replace(case.fit, test=test), spoil=test)
    np.testing.assert_array_equal(own.refined, spoiled.refined)
    np.testing.assert_array_equal(own.correction.readout, spoiled.correction.readout)
