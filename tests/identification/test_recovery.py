"""Virtual robots with known errors: identification finds what they do, and its sigmas hold what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.summary import summarise
from kincal.urdf.description import Identify
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import Motion

FAR_W = Motion(Rotation.from_rotvec([2.0, -1.0, 1.5]).as_matrix(), np.array([2.0, -1.0, 0.7]))
FAR_T = Motion(Rotation.from_rotvec([-0.5, 1.0, 2.0]).as_matrix(), np.array([0.1, 0.0, 0.3]))
CASES = {
    "ups3_s orientation": ("ups3_s", ("orientation",), 60),
    "ups3_s tilt": ("ups3_s", ("tilt",), 80),
    "ups3_s tilt and yaw": ("ups3_s", ("tilt", "yaw"), 60),
    "ups3_frame orientation": ("ups3_frame", ("orientation",), 60),
    "jugglebot pose": ("jugglebot", ("orientation", "position"), 80),
    "ur10 pose": ("ur10", ("orientation", "position"), 40),
    "ur10 position": ("ur10", ("position",), 60),
}


def prediction_error(loaded, p: np.ndarray, truth: np.ndarray, channels, readings) -> float:
    """The largest error of what `channels` see, over fresh readings [rad or m]."""
    predicted, true = loaded.poses(p, readings), loaded.poses(truth, readings)
    errors = []
    if "position" in channels:
        errors.append(np.linalg.norm(predicted.translation - true.translation, axis=1))
    if "orientation" in channels or "yaw" in channels:
        turned = np.swapaxes(true.rotation, 1, 2) @ predicted.rotation
        errors.append(Rotation.from_matrix(turned).magnitude())
    elif "tilt" in channels:
        errors.append(np.linalg.norm(predicted.rotation[:, 2] - true.rotation[:, 2], axis=1))
    return float(np.max(errors))


@pytest.mark.parametrize(
    "name, channels, n, frames",
    [
        pytest.param(*case, frames, id=f"{name}-{frames}")
        for name, case in CASES.items()
        for frames in ("near", "far")
        if (name, frames) != ("jugglebot pose", "near")  # twelve seconds each
    ],
)
def test_noise_free_measurements_give_back_the_robot(name, channels, n, frames, robot):
    """A robot at random within its tolerances, W and T near or of any size: 200 fresh poses to 1e-7 m and rad.

    Sigmas are so small that the priors' pull is below that (jugglebot: 1e-6, its valley is narrow and curved).
    """
    loaded = robot(name)
    far = {"instrument": FAR_W, "target": FAR_T} if frames == "far" else {}
    truth = loaded.random_parameters(1, **far)
    measured = loaded.measure(
        truth,
        loaded.readings(n, 10),
        channels,
        dict.fromkeys(channels, 1e-7 if name == "jugglebot" else 1e-8),
    )
    found = estimate_parameters(loaded.model, measured)
    assert found.success
    assert found.cost < len(loaded.model.parameters)  # half the truth's prior, and little else
    fresh = loaded.readings(200, 11)
    before = loaded.model.with_frames(np.zeros(len(truth)), *[Motion.from_vector(v) for v in truth[-12:].reshape(2, 6)])
    assert prediction_error(loaded, before, truth, channels, fresh) > 1e-4  # there was something to find
    assert prediction_error(loaded, found.p, truth, channels, fresh) < (1e-6 if name == "jugglebot" else 1e-7)


@pytest.mark.parametrize("name, sigma, seed", [("ups3_s", 1e-9, 1), ("ups3_s", 1e-9, 2), ("ur10", 1e-9, 1)])
def test_identification_converges_however_precise_the_data(name, sigma, seed, robot):
    """Noise-free data and a sigma far below the tolerances: a narrow curved valley, and yet its bottom is found.

    That of jugglebot with 1e-7: in the test above.
    """
    loaded = robot(name)
    channels = ("orientation",) if name == "ups3_s" else ("orientation", "position")
    measured = loaded.measure(
        loaded.random_parameters(seed), loaded.readings(80, 10), channels, dict.fromkeys(channels, sigma)
    )
    assert estimate_parameters(loaded.model, measured).cost < len(
        loaded.model.parameters
    )  # half the truth's prior, and little else


@pytest.mark.parametrize(
    "name, channels, n", [CASES["ups3_s orientation"], CASES["jugglebot pose"], CASES["ur10 pose"]]
)
def test_noisy_measurements_leave_a_chi_square_of_one(name, channels, n, robot):
    """chi-square has its degrees of freedom as mean: inside its 99.99 % interval."""
    loaded = robot(name)
    truth = loaded.random_parameters(2)
    std = {"orientation": 1e-5, "position": 2e-5}
    measured = loaded.measure(truth, loaded.readings(n, 12), channels, std, np.random.default_rng(3))
    found = summarise(
        loaded.model, measured, estimate_parameters(loaded.model, measured), register(loaded.model, measured)
    )
    low, high = chi2.ppf([5e-5, 1 - 5e-5], found.degrees_of_freedom)
    assert low < found.chi_square < high
    rows = found.residual.size
    assert rows - len(loaded.model.parameters) < found.degrees_of_freedom < rows - 6
    assert len(found.outliers) < 0.1 * n
    expected = np.rad2deg(1e-5) * np.sqrt(3 * found.degrees_of_freedom / rows)
    assert found.residual_size["orientation_deg"] == pytest.approx(expected, rel=0.4)


@pytest.mark.parametrize(
    "name, channels, n",
    [("ups3_s", ("orientation",), 15), ("ups3_s", ("orientation",), 60), ("ur10", ("orientation", "position"), 20)],
)
def test_sigmas_of_predicted_poses_hold_what_they_promise(name, channels, n, robot):
    """Robots drawn from the prior, measured with noise: errors of fresh poses, divided by their own sigmas.

    24 robots times 3 (or 6) components times 5 poses; those of one robot are correlated, so the effective number is
    some 24 * 3. A unit variance is then estimated to 1 +- 0.17: 0.6 .. 1.5 is beyond 2.5 sigma. Of 360 values that
    should hold in 95 % of cases, 90 % and more must.
    """
    loaded = robot(name)
    std = {"orientation": 1e-5, "position": 2e-5}
    fresh = loaded.readings(5, 21)
    normalised = []
    for seed in range(24):
        truth = loaded.random_parameters(100 + seed)
        noise = np.random.default_rng(200 + seed)
        measured = loaded.measure(truth, loaded.readings(n, 300 + seed), channels, std, noise)
        found = estimate_parameters(loaded.model, measured)
        jacobian = loaded.model.pose_jacobian(found.p, fresh, loaded.model.robot(found.p).close(fresh).q)
        sigma = np.sqrt(np.einsum("nij,jk,nik->ni", jacobian, found.covariance, jacobian))
        predicted, true = loaded.poses(found.p, fresh), loaded.poses(truth, fresh)
        turned = Rotation.from_matrix(np.swapaxes(true.rotation, 1, 2) @ predicted.rotation).as_rotvec()
        errors = np.concatenate([turned, predicted.translation - true.translation], axis=1)
        kept = slice(0, 6 if "position" in channels else 3)
        normalised.append((errors / np.where(sigma > 0, sigma, np.inf))[:, kept].ravel())
    values = np.array(normalised)
    assert 0.6 < np.mean(values**2) < 1.5
    assert np.mean(np.abs(values) < 1.96) > 0.9
    assert abs(np.mean(values)) < 0.5


def test_parameters_sigmas_hold_what_they_promise(robot):
    """(identified - actual) / sigma of all parameters with a prior, over 20 robots: as a unit normal.

    Where only the prior speaks this is the prior itself; a wrong sigma of any kind shows in the 95 % share.
    """
    loaded = robot("ups3_s")
    tight = ~loaded.model.parameters.flat
    values = []
    for seed in range(20):
        truth = loaded.random_parameters(400 + seed)
        noise = np.random.default_rng(500 + seed)
        measured = loaded.measure(
            truth, loaded.readings(30, 600 + seed), ("orientation",), {"orientation": 1e-5}, noise
        )
        found = estimate_parameters(loaded.model, measured)
        sigma = np.sqrt(np.diag(found.covariance))[tight]
        values.append((found.p - truth)[tight] / sigma)
        assert np.all(sigma <= (1 + 1e-9) * loaded.model.parameters.tolerance[tight])
    inside = np.mean(np.abs(values) < 1.96)
    assert 0.92 < inside < 0.98  # of 20 * 96 values: one sigma is 0.005 if independent, 0.01 with their correlations


def test_one_bad_pose_is_named_as_an_outlier(robot):
    """A position that is 100 sigmas off."""
    loaded = robot("ur10")
    truth, readings = loaded.random_parameters(7), loaded.readings(40, 7)
    measured = loaded.measure(truth, readings, ("orientation", "position"), noise=np.random.default_rng(8))
    measured.values["position"][17] += 100 * measured.std["position"][17] * np.array([0.6, 0.8, 0.0])
    found = summarise(
        loaded.model, measured, estimate_parameters(loaded.model, measured), register(loaded.model, measured)
    )
    assert found.outliers[0].pose == 17 or 17 in [o.pose for o in found.outliers]
    assert any("position" in o.reason for o in found.outliers if o.pose == 17)


def test_tilt_leaves_the_turn_about_gravity_without_a_sigma(robot):
    """What nothing can see has an infinite sigma, not a small one: some of W's numbers."""
    loaded = robot("ups3_s")
    measured = loaded.measure(loaded.random_parameters(1), loaded.readings(40, 1), ("tilt",))
    found = summarise(
        loaded.model, measured, estimate_parameters(loaded.model, measured), register(loaded.model, measured)
    )
    infinite = {name for name, std in zip(found.names, found.std, strict=True) if np.isinf(std)}
    assert "instrument.rz" in infinite
    assert {f"{frame}.{c}" for frame in ("instrument", "target") for c in "xyz"} <= infinite
    assert all(name.startswith(("instrument.", "target.")) for name in infinite)


def test_three_poses_are_enough_for_an_answer_with_honest_sigmas(robot):
    """MAP is well posed for any n that can register W and T; sigmas stay within the priors."""
    loaded = robot("jugglebot")
    measured = loaded.measure(loaded.random_parameters(3), loaded.readings(3, 3), ("orientation", "position"))
    found = estimate_parameters(loaded.model, measured)
    tight = ~loaded.model.parameters.flat
    assert found.success
    assert np.all(np.sqrt(np.diag(found.covariance))[tight] <= loaded.model.parameters.tolerance[tight] * (1 + 1e-9))


def test_readings_at_which_the_loops_cannot_close_name_the_pose(robot):
    """Leg 1 half a metre longer than the triangle inequality allows."""
    loaded = robot("ups3_s")
    measured = loaded.measure(loaded.random_parameters(0), loaded.readings(6, 0), ("orientation",))
    measured.readings[4] = [1.5, 0.4, 0.4]
    with pytest.raises(InputError, match="measured pose 4: the loops can't be closed"):
        estimate_parameters(loaded.model, measured)


def test_identification_that_cannot_converge_says_so(robot):
    loaded = robot("jugglebot")
    noise = np.random.default_rng(0)
    measured = loaded.measure(
        loaded.random_parameters(5), loaded.readings(30, 0), ("orientation", "position"), None, noise
    )
    with pytest.raises(CalibrationError, match="did not converge"):
        estimate_parameters(loaded.model, measured, Identify(max_iterations=1))


def test_tolerances_of_the_description_are_the_priors(robot):
    """Every parameter's sigma and unit, by its kind, from [tolerance] and [actuator]."""
    loaded = robot("jugglebot")
    tolerance = loaded.description.tolerance
    parameters = ErrorModel.of(loaded.chain, loaded.description.actuator, tolerance).parameters
    by_name = dict(zip(parameters.names, zip(parameters.tolerance, parameters.units, strict=True), strict=True))
    assert by_name["leg1_u1.x"] == (pytest.approx(2e-3), "m")
    assert by_name["leg1_u1.rx"] == (pytest.approx(np.deg2rad(0.3)), "rad")
    assert by_name["leg2_slide.zero"] == (pytest.approx(5e-3), "m")
    assert by_name["leg2_slide.gain"][0] == pytest.approx(0.05 * 0.0711967)
    assert by_name["leg3.leg3_tip.x"] == (pytest.approx(2e-3), "m")
    assert "leg3.leg3_tip.rx" not in by_name  # a point has no orientation
    assert np.isinf(by_name["instrument.x"][0])
    assert np.isinf(by_name["target.rz"][0])
    assert len(parameters) == 21 * 6 + 5 * 2 * 3 + 2 * 6 + 12
