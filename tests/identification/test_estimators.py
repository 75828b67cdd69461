"""Estimators of whole robots against textbook formulas on their tall Jacobians, and against what they must not do.

`test_shrinkage.py` has the linear problem in itself; here the loops are closed, and every estimate is the minimum of
what it says it minimises.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate, estimate_parameters, register
from kincal.identification.measurements import Measurements
from kincal.identification.robust_loss import Loss
from kincal.identification.summary import summarise
from kincal.urdf.description import Identify, Tolerance
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import log

N_FRAMES = 12
ESTIMATORS = ("map", "least_squares", "ridge", "liu", "truncated_svd")
CASES = [("ups2_u", ("orientation",)), ("ups2_u", ("tilt",)), ("ur10", ("orientation", "position"))]


def noisy(loaded, channels, n: int, seed: int, tolerances: float = 1.0, sigma: float = 1e-5):
    """(truth, Measurements with noise) of a robot drawn from its tolerances."""
    truth = loaded.random_parameters(seed, tolerances)
    noise = np.random.default_rng([seed, 5])
    return truth, loaded.measure(truth, loaded.readings(n, seed), channels, dict.fromkeys(channels, sigma), noise)


def tall(model: ErrorModel, measured: Measurements, estimate: Estimate) -> np.ndarray:
    """The whitened Jacobian (rows, n_parameters) at an estimate."""
    return model.jacobian(estimate.p, measured, estimate.q).reshape(-1, len(estimate.p))


def without_frames(jacobian: np.ndarray, columns: np.ndarray) -> np.ndarray:
    frames = jacobian[:, -N_FRAMES:] * 1e-3
    return columns - frames @ (np.linalg.pinv(frames, rcond=1e-9) @ columns)


def standardised(model: ErrorModel, measured: Measurements, registered: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Of the registered robot: D, that makes columns of unit length, and its identifiable subspace (rank, n)."""
    jacobian = tall(model, measured, registered)
    geometry = without_frames(jacobian, jacobian[:, :-N_FRAMES])
    length = np.linalg.norm(geometry, axis=0)
    felt = length * model.parameters.tolerance[:-N_FRAMES]
    scale = np.where(felt > 1e-9 * felt.max(), 1 / np.maximum(length, 1e-300), 0.0)
    _, singular, vt = np.linalg.svd(geometry * scale, full_matrices=False)
    return scale, vt[singular > 1e-9 * singular[0]]


def predictions_apart(loaded, first: np.ndarray, second: np.ndarray, channels) -> float:
    """The largest difference of what `channels` see at fresh poses [rad or m]."""
    readings = loaded.readings(40, 77)
    a, b = loaded.poses(first, readings), loaded.poses(second, readings)
    if "tilt" in channels:
        return float(np.abs(a.rotation[:, 2] - b.rotation[:, 2]).max())
    turned = np.abs(log(np.swapaxes(a.rotation, 1, 2) @ b.rotation)).max()
    moved = np.abs(a.translation - b.translation).max() if "position" in channels else 0.0
    return float(max(turned, moved))


# What each estimator minimises


@pytest.mark.parametrize("scale", [1.0, 2.5])
@pytest.mark.parametrize("loss", ["gaussian", "huber"])
@pytest.mark.parametrize("name, channels", CASES)
def test_covariance_of_map_is_the_inverse_of_the_information(name, channels, loss, scale, robot):
    """(J'J + P)^-1 of the tall Jacobian, 0.95 of J'J for a robust loss; columns that nothing sees are struck out."""
    loaded = robot(name)
    model, tolerance = loaded.model, loaded.model.parameters.tolerance
    _, measured = noisy(loaded, channels, 25, 1)
    found = estimate_parameters(model, measured, Identify(loss=loss, shrinkage=scale))
    assert found.shrinkage == scale
    unit = np.where(np.isfinite(tolerance), tolerance, 1e-3)
    jacobian = tall(model, measured, found) * unit
    precision = np.diag(np.where(np.isfinite(tolerance), 1 / scale**2, 0.0))
    information = (0.95 if loss == "huber" else 1.0) * jacobian.T @ jacobian + precision
    if channels == ("tilt",):  # the turn about gravity: nothing sees it, so it is not in the covariance
        values, vectors = np.linalg.eigh(information)
        null = vectors[:, values < 1e-6]
        assert null.shape[1] == 7
        expected = np.linalg.inv(information + null @ null.T) - null @ null.T
        assert set(np.flatnonzero(found.unseen)) >= set(np.flatnonzero(np.sum(null**2, axis=1) > 1e-6))
    else:
        seen = ~found.unseen
        assert list(found.unseen[-N_FRAMES:]) == ([True] * 3 + [False] * 3) * 2 or not found.unseen.any()
        expected = np.zeros_like(information)
        expected[np.ix_(seen, seen)] = np.linalg.inv(information[np.ix_(seen, seen)])
    geometry = slice(0, -N_FRAMES)
    np.testing.assert_allclose(
        (found.covariance / np.outer(unit, unit))[geometry, geometry],
        expected[geometry, geometry],
        rtol=1e-4,
        atol=1e-6 * np.abs(expected[geometry, geometry]).max(),
    )
    # and of predictions, W and T and all their correlations included
    fresh = jacobian[::7]
    np.testing.assert_allclose(
        np.einsum("ij,jk,ik->i", fresh / unit, found.covariance, fresh / unit),
        np.einsum("ij,jk,ik->i", fresh, expected, fresh),
        rtol=1e-4,
    )
    shares = 1 - np.diag(expected)[geometry] / scale**2
    np.testing.assert_allclose(found.resolution[geometry], shares, rtol=1e-4, atol=1e-6)
    assert found.effective == pytest.approx(np.trace(expected @ (information - precision)), rel=1e-4)


@pytest.mark.parametrize("loss", ["gaussian", "huber", "cauchy"])
@pytest.mark.parametrize("name, channels", CASES)
def test_map_is_a_minimum(name, channels, loss, robot):
    """The gradient of loss and priors, J' (weight r) + p / sigma^2: the step it asks for is nothing beside sigmas."""
    loaded = robot(name)
    _, measured = noisy(loaded, channels, 25, 2)
    found = estimate_parameters(loaded.model, measured, Identify(loss=loss))
    tolerance = loaded.model.parameters.tolerance
    unit = np.where(np.isfinite(tolerance), tolerance, 1e-3)
    weighted = (Loss(loss).weights(found.residual, channels) * found.residual).ravel()
    data = unit * (tall(loaded.model, measured, found).T @ weighted)
    prior = unit * found.p / tolerance**2
    variance, seen = found.covariance / np.outer(unit, unit), ~found.unseen
    sigma = np.sqrt(np.diag(variance))[seen]
    assert np.abs((variance @ (data + prior))[seen] / sigma).max() < 2e-3
    assert np.abs((variance @ prior)[seen] / sigma).max() > 0.1
    np.testing.assert_allclose(found.cost, Loss(loss).cost(found.residual, channels) + 0.5 * prior @ prior)


@pytest.mark.parametrize("name, channels", CASES)
def test_ridge_is_the_textbooks(name, channels, robot):
    """(X'X + k)^-1 X'y, X of unit length and W, T projected out, on the identifiable subspace; linearised at itself."""
    loaded, k = robot(name), 0.02
    model = loaded.model
    _, measured = noisy(loaded, channels, 25, 3)
    registered = register(model, measured)
    scale, within = standardised(model, measured, registered)
    found = estimate_parameters(model, measured, Identify(estimator="ridge", shrinkage=k), registered)
    assert found.shrinkage == k
    jacobian = tall(model, measured, found)
    x = without_frames(jacobian, jacobian[:, :-N_FRAMES]) * scale @ within.T
    y = without_frames(jacobian, jacobian @ found.p - found.residual.ravel())
    expected = scale * (within.T @ np.linalg.solve(x.T @ x + k * np.eye(len(within)), x.T @ y))
    sigma = np.sqrt(np.diag(found.covariance))[:-N_FRAMES]
    np.testing.assert_allclose((found.p[:-N_FRAMES] - expected) / sigma, 0, atol=1e-3)
    assert np.abs(found.p[:-N_FRAMES] / sigma).max() > 1


@pytest.mark.parametrize("name, channels", CASES)
def test_truncated_svd_is_the_textbooks(name, channels, robot):
    """The k leading directions of the standardised Jacobian at the MAP estimate, and least squares along them alone."""
    loaded, k = robot(name), 9
    model = loaded.model
    _, measured = noisy(loaded, channels, 25, 4)
    registered = register(model, measured)
    scale, within = standardised(model, measured, registered)
    at = tall(model, measured, estimate_parameters(model, measured, None, registered))
    leading = np.linalg.svd(without_frames(at, at[:, :-N_FRAMES]) * scale @ within.T, full_matrices=False)[2][:k]
    directions = scale[:, None] * (leading @ within).T
    found = estimate_parameters(model, measured, Identify(estimator="truncated_svd", shrinkage=k), registered)
    assert found.shrinkage == k
    along = np.linalg.lstsq(directions, found.p[:-N_FRAMES], rcond=None)[0]
    apart = directions @ along - found.p[:-N_FRAMES]
    assert np.abs(apart / model.parameters.tolerance[:-N_FRAMES]).max() < 1e-4
    jacobian = tall(model, measured, found)
    frames = np.linalg.matrix_rank(jacobian[:, -N_FRAMES:] * 1e-3, rtol=1e-9)
    assert found.effective == pytest.approx(k + frames)
    x = without_frames(jacobian, jacobian[:, :-N_FRAMES] @ directions)
    y = without_frames(jacobian, jacobian @ found.p - found.residual.ravel())
    sigma = np.sqrt(np.diag(np.linalg.inv(x.T @ x)))
    np.testing.assert_allclose((np.linalg.lstsq(x, y, rcond=None)[0] - along) / sigma, 0, atol=1e-3)


@pytest.mark.parametrize("d", [0.0, 0.3])
@pytest.mark.parametrize("name, channels", CASES)
def test_liu_is_the_textbooks(name, channels, d, robot):
    """(X'X + 1)^-1 (X'X + d) of least squares (d = 1), X at the MAP estimate; W and T follow what it leaves."""
    loaded = robot(name)
    model = loaded.model
    _, measured = noisy(loaded, channels, 25, 5)
    registered = register(model, measured)
    scale, within = standardised(model, measured, registered)
    at = tall(model, measured, estimate_parameters(model, measured, None, registered))
    x = without_frames(at, at[:, :-N_FRAMES]) * scale @ within.T
    square, eye = x.T @ x, np.eye(len(within))
    least = estimate_parameters(model, measured, Identify(estimator="liu", shrinkage=1.0), registered)
    found = estimate_parameters(model, measured, Identify(estimator="liu", shrinkage=d), registered)
    assert found.shrinkage == d
    inverse = np.where(scale > 0, 1 / np.maximum(scale, 1e-300), 0.0)
    beta = within @ (least.p[:-N_FRAMES] * inverse)
    expected = scale * (within.T @ np.linalg.solve(square + eye, (square + d * eye) @ beta))
    sigma = np.sqrt(np.diag(found.covariance))[:-N_FRAMES]
    np.testing.assert_allclose((found.p[:-N_FRAMES] - expected) / sigma, 0, atol=1e-3)
    assert np.abs((found.p - least.p)[:-N_FRAMES] / sigma).max() > 0.1
    jacobian = tall(model, measured, found)
    frames = jacobian[:, -N_FRAMES:] * 1e-3
    rest = without_frames(jacobian, found.residual.ravel())
    assert np.linalg.norm(found.residual.ravel() - rest) < 1e-3 * np.linalg.norm(rest)
    assert np.linalg.norm(frames) > 0


# Limits


@pytest.mark.parametrize("name, channels", CASES)
def test_without_shrinkage_all_are_least_squares(name, channels, robot):
    """k to 0, d = 1, all directions: the same predictions, to a fifth of a reading's sigma.

    Their parameters differ along what nothing sees: the norm that is least there is another. So errors are small here,
    a fiftieth of the tolerances: where they are not, these directions are seen a little, by effects of second order.
    """
    loaded = robot(name)
    _, measured = noisy(loaded, channels, 40, 6, 0.02, 2e-8)
    registered = register(loaded.model, measured)
    least = estimate_parameters(loaded.model, measured, Identify(estimator="least_squares"), registered)
    limits = {"ridge": (0.0, 1e-13), "liu": (1.0,), "truncated_svd": (200.0,)}
    for estimator, values in limits.items():
        for value in values:
            found = estimate_parameters(
                loaded.model, measured, Identify(estimator=estimator, shrinkage=value), registered
            )
            assert predictions_apart(loaded, found.p, least.p, channels) < 4e-9
            assert found.effective == pytest.approx(least.effective, abs=1e-2)
            np.testing.assert_allclose(found.residual, least.residual, atol=2e-2)


@pytest.mark.parametrize("name, channels", CASES)
def test_least_squares_know_nothing_of_the_tolerances(name, channels, robot):
    """Positions ten times, rotations a tenth as sure: predictions and residuals stay, parameters' sigmas do not."""
    loaded = robot(name)
    _, measured = noisy(loaded, channels, 40, 7, 0.1, 1e-6)
    given = loaded.description.tolerance
    other = given.model_copy(
        update={"position_mm": 10 * given.position_mm, "rotation_deg": 0.1 * given.rotation_deg, "actuator_gain": 3e-3}
    )
    models = [ErrorModel.of(loaded.chain, loaded.description.actuator, t) for t in (given, other)]
    found = [estimate_parameters(m, measured, Identify(estimator="least_squares")) for m in models]
    assert predictions_apart(loaded, found[0].p, found[1].p, channels) < 1e-7
    np.testing.assert_allclose(found[0].residual, found[1].residual, atol=2e-2)
    assert found[0].effective == pytest.approx(found[1].effective)
    sigmas = [np.sqrt(np.diag(f.covariance))[0] for f in found]
    assert sigmas[1] > 5 * sigmas[0]


def test_scale_of_the_priors_is_that_of_the_tolerances(robot):
    """shrinkage = 2 is MAP with tolerances twice as wide, covariance and all."""
    loaded = robot("ups2_u")
    _, measured = noisy(loaded, ("orientation",), 25, 8)
    given = loaded.description.tolerance
    twice = Tolerance(**{name: 2 * value for name, value in given.model_dump().items()})
    wide = ErrorModel.of(loaded.chain, loaded.description.actuator, twice)
    first = estimate_parameters(loaded.model, measured, Identify(shrinkage=2))
    second = estimate_parameters(wide, measured)
    sigma = np.sqrt(np.diag(second.covariance))
    np.testing.assert_allclose((first.p - second.p)[:-N_FRAMES] / sigma[:-N_FRAMES], 0, atol=1e-4)
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-4, atol=1e-5 * second.covariance.max())
    np.testing.assert_allclose(first.resolution, second.resolution, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name, channels", CASES)
def test_nothing_moves_along_what_nothing_sees(name, channels, estimator, robot):
    """In units of its scale an estimate of the geometry is orthogonal to the Jacobian's null space."""
    loaded = robot(name)
    _, measured = noisy(loaded, channels, 40, 9)
    model = loaded.model
    registered = register(model, measured)
    found = estimate_parameters(model, measured, Identify(estimator=estimator), registered)
    if estimator in ("map", "least_squares"):
        scale = model.parameters.tolerance[:-N_FRAMES]
        jacobian = tall(model, measured, found if estimator == "map" else registered)
        x = without_frames(jacobian, jacobian[:, :-N_FRAMES]) * scale
        _, singular, vt = np.linalg.svd(x)
        null = vt[np.concatenate([singular, np.zeros(len(vt) - len(singular))]) < 1e-9 * singular[0]]
    else:
        scale, within = standardised(model, measured, registered)
        null = np.linalg.svd(within)[2][len(within) :]
        assert np.all(found.p[:-N_FRAMES][scale == 0] == 0)
    assert len(null) > 10
    change = np.where(scale > 0, found.p[:-N_FRAMES] / np.where(scale > 0, scale, 1.0), 0.0)
    assert np.linalg.norm(null @ change) < 1e-4 * np.linalg.norm(change)


# Choice of the shrinkage


def test_scale_of_the_priors_follows_the_robots(robot):
    """Drawn from a fifth, from one and from ten tolerances: medians over 5 robots, by generalised cross-validation.

    It is a blunt instrument: what is seen well is predicted alike by any scale, and a tie goes to 1.
    """
    loaded = robot("ups2_u")
    median = {}
    for tolerances in (0.2, 1.0, 10.0):
        chosen = []
        for seed in range(5):
            _, measured = noisy(loaded, ("orientation",), 50, 100 + seed, tolerances)
            chosen.append(estimate_parameters(loaded.model, measured, Identify(shrinkage="gcv")).shrinkage)
        median[tolerances] = float(np.median(chosen))
    assert median[0.2] < 0.5
    assert 0.7 < median[1.0] < 1.5
    assert 4 < median[10.0] < 15


@pytest.mark.parametrize("how", ["gcv", "kfold"])
def test_a_scale_at_its_bound_is_refused(how, robot):
    """Tolerances a thousand times too small."""
    loaded = robot("ups2_u")
    given = loaded.description.tolerance
    narrow = Tolerance(**{name: 1e-3 * value for name, value in given.model_dump().items()})
    model = ErrorModel.of(loaded.chain, loaded.description.actuator, narrow)
    _, measured = noisy(loaded, ("orientation",), 40, 10, 3.0)
    with pytest.raises(CalibrationError, match=r"ended at its bound, 100: .*correct \[tolerance\]"):
        estimate_parameters(model, measured, Identify(shrinkage=how))


@pytest.mark.parametrize("estimator", ESTIMATORS[2:])
def test_a_shrinkage_chosen_and_then_given_is_the_same_estimate(estimator, robot):
    loaded = robot("ups2_u")
    _, measured = noisy(loaded, ("orientation",), 25, 11)
    for how in (None, "gcv", "kfold"):
        chosen = estimate_parameters(loaded.model, measured, Identify(estimator=estimator, shrinkage=how))
        given = estimate_parameters(loaded.model, measured, Identify(estimator=estimator, shrinkage=chosen.shrinkage))
        np.testing.assert_array_equal(chosen.p, given.p)
        np.testing.assert_array_equal(chosen.covariance, given.covariance)


@pytest.mark.parametrize(
    "settings", [{"estimator": "map", "shrinkage": 0}, {"estimator": "liu", "shrinkage": 1.5}, {"shrinkage": -1}]
)
def test_shrinkages_that_mean_nothing_are_refused(settings):
    with pytest.raises(ValueError, match="shrinkage"):
        Identify(**settings)


# Residuals and sensors


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name, channels", CASES)
def test_chi_square_has_its_degrees_of_freedom(name, channels, estimator, robot):
    """Four robots together: within 4 standard deviations, sqrt(2 dof), of the mean."""
    loaded, chi_square, freedom = robot(name), 0.0, 0.0
    for seed in range(4):
        _, measured = noisy(loaded, channels, 50, 20 + seed)
        found = estimate_parameters(loaded.model, measured, Identify(estimator=estimator))
        chi_square, freedom = chi_square + np.sum(found.residual**2), freedom + measured.rows - found.effective
    assert abs(chi_square - freedom) < 4 * np.sqrt(2 * freedom)


def said_wrongly(measured: Measurements, factors: dict[str, float]) -> Measurements:
    """The same readings, their sigmas times a factor and not vouched for."""
    return replace(measured.scaled(factors), assumed=tuple(factors))


@pytest.mark.parametrize("estimator, loss", [*((e, "gaussian") for e in ESTIMATORS), ("map", "huber")])
def test_sigmas_that_nobody_gave_are_recovered(estimator, loss, robot):
    """Orientation assumed ten times too coarse, position ten times too fine; three robots.

    Some 200 free residuals, half of them of each sensor: one sigma is known to 1 / sqrt(200) = 7 %; 4 of them over the
    root of three robots for their mean, four of them for each.
    """
    loaded, channels = robot("ur10"), ("orientation", "position")
    found = []
    for seed in range(3):
        _, measured = noisy(loaded, channels, 40, 30 + seed)
        wrong = said_wrongly(measured, {"orientation": 10.0, "position": 0.1})
        estimate = estimate_parameters(loaded.model, wrong, Identify(estimator=estimator, loss=loss))
        found.append([10.0 * estimate.sigma_factors["orientation"], 0.1 * estimate.sigma_factors["position"]])
        given = estimate_parameters(loaded.model, measured, Identify(estimator=estimator, loss=loss))
        if estimator in ("map", "least_squares"):
            inside = np.sqrt(np.diag(given.covariance))[:-N_FRAMES]
            assert np.abs((estimate.p - given.p)[:-N_FRAMES] / inside).max() < 1
    np.testing.assert_allclose(found, 1.0, atol=4 * 0.07)
    np.testing.assert_allclose(np.mean(found, axis=0), 1.0, atol=4 * 0.07 / np.sqrt(3))


def test_a_sigma_that_is_given_is_not_estimated(robot):
    """One sensor vouched for, one not; and none at all."""
    loaded, channels = robot("ur10"), ("orientation", "position")
    _, measured = noisy(loaded, channels, 40, 40)
    assert estimate_parameters(loaded.model, measured).sigma_factors == {}
    half = said_wrongly(measured, {"position": 0.1})
    registered = register(loaded.model, half)
    estimate = estimate_parameters(loaded.model, half, None, registered)
    assert set(estimate.sigma_factors) == {"position"}
    assert 0.1 * estimate.sigma_factors["position"] == pytest.approx(1.0, abs=4 * 0.07)
    found = summarise(loaded.model, half, estimate, registered)
    assert found.sensor_estimated == dict(estimate.sigma_factors)
    assert found.sensor_std["orientation"] == pytest.approx(1e-5)
    assert found.sensor_std["position"] == pytest.approx(1e-5, rel=4 * 0.07)
    assert abs(found.chi_square - found.degrees_of_freedom) < 4 * np.sqrt(2 * found.degrees_of_freedom)


@pytest.mark.parametrize("loss", ["gaussian", "huber"])
@pytest.mark.parametrize(
    "name, channels, n", [("ups2_u", ("orientation",), 4), ("ur10", ("orientation", "position"), 5)]
)
def test_few_poses_cannot_tell_a_sigma(name, channels, n, loss, robot):
    loaded = robot(name)
    _, measured = noisy(loaded, channels, n, 50)
    with pytest.raises(
        InputError, match=rf"sigma of orientation is not given, and {n} poses can't determine it .*\[sensor\]"
    ):
        estimate_parameters(loaded.model, replace(measured, assumed=channels), Identify(loss=loss))
