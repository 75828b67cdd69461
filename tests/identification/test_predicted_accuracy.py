"""Observability indexes against hand-computed ones; predicted accuracy against Monte Carlo and real identifications."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi

from kincal.identification.accuracy import gravity_error, orientation_error
from kincal.identification.expected import FLAT, all_feasible, information, prior_sigma
from kincal.identification.identifiability import identifiability
from kincal.identification.observability import Observability, indexes, observability
from kincal.identification.predicted_accuracy import Probe, mean_length
from kincal.urdf.workspace import sample

CASES = [
    ("ups3_s", ("orientation",)),
    ("ups3_s", ("tilt",)),
    ("jugglebot", ("orientation", "position")),
    ("ur10", ("orientation", "position")),
]


def sites(loaded, n: int, seed: int):
    u = sample(loaded.description.workspace, loaded.chain.tool_axes, n, seed)
    return all_feasible(loaded.model, loaded.description.workspace, u, "test")


# O1 .. O5


def test_indexes_by_hand():
    """4, 2, 1 of four poses: (4 * 2 * 1)^(1/3) / 2 = 1; 1/4; 1; 1/4; 1 / (1/4 + 1/2 + 1) = 4/7."""
    found = indexes(np.array([4.0, 2.0, 1.0]), 4)
    assert (found.o1, found.o2, found.o3, found.o4, found.o5) == pytest.approx((1, 1 / 4, 1, 1 / 4, 4 / 7))
    assert (found.excited, found.excitable, found.condition_number) == (3, 3, 4)


def test_indexes_of_poses_that_leave_a_direction_out():
    found = indexes(np.array([4.0, 2.0, 1e-15]), 4)
    assert found == Observability(2, 3, 0, 0, 0, 0, 0)
    assert found.condition_number == float("inf")


@pytest.mark.parametrize("name, channels", CASES)
def test_indexes_of_robots_against_numpy(name, channels, robot):
    """The Gram matrix in a basis of what 200 other poses excite: its determinant, eigenvalues and their inverses."""
    loaded = robot(name)
    parameters, n = loaded.model.parameters, 40
    scale = np.where(parameters.flat, 1e-3, parameters.tolerance)

    def jacobian(count: int, seed: int) -> np.ndarray:
        at = sites(loaded, count, seed)
        blocks = information(loaded.model, at, channels, loaded.description.sensor)
        return blocks / prior_sigma(parameters)

    reference = jacobian(200, 1).reshape(-1, len(parameters))
    rank = identifiability(reference, parameters).rank
    basis = np.linalg.svd(reference * scale, full_matrices=False)[2][:rank].T
    found = observability(jacobian(n, 2), parameters, rank)
    projected = jacobian(n, 2).reshape(-1, len(parameters)) * scale @ basis
    factor = np.linalg.qr(projected, mode="r")
    root = np.exp(np.mean(np.log(np.abs(np.diag(factor)))))  # det of the Gram matrix, to the power 1 / (2 L)
    assert (found.excited, found.excitable) == (rank, rank)
    assert found.o1 == pytest.approx(root / np.sqrt(n), rel=1e-6)
    assert found.condition_number == pytest.approx(np.linalg.cond(projected), rel=1e-6)
    assert found.o3 == pytest.approx(1 / np.linalg.norm(np.linalg.pinv(projected), 2), rel=1e-6)
    assert found.o4 == pytest.approx(found.o3**2 / np.linalg.norm(projected, 2), rel=1e-6)
    assert found.o5 == pytest.approx(1 / np.linalg.norm(np.linalg.pinv(projected), "nuc"), rel=1e-6)


def test_fewer_rows_than_directions(robot):
    loaded = robot("ups3_s")
    blocks = information(loaded.model, sites(loaded, 5, 1), ("orientation",), loaded.description.sensor)
    found = observability(blocks / prior_sigma(loaded.model.parameters), loaded.model.parameters, 27)
    assert (found.excited, found.excitable, found.o1) == (15, 27, 0)


# Mean lengths of Gaussians


@pytest.mark.parametrize("k", [1, 2, 3])
def test_mean_length_of_equal_variances(k):
    """The chi distribution's mean; for one variance of three not zero, the half-normal's."""
    assert mean_length(4 * np.eye(k)[None])[0] == pytest.approx(2 * chi(k).mean(), rel=1e-6)
    within_three = np.diag([4.0] * k + [0.0] * (3 - k))
    assert mean_length(within_three[None])[0] == pytest.approx(2 * chi(k).mean(), rel=1e-6)


def test_mean_length_against_monte_carlo():
    random = np.random.default_rng(0)
    root = random.normal(size=(5, 3, 3)) * np.array([1e-6, 1e-3, 1.0, 30.0, 1e5])[:, None, None]
    drawn = np.linalg.norm(random.normal(size=(200_000, 3)) @ root.swapaxes(1, 2), axis=2).mean(axis=1)
    np.testing.assert_allclose(mean_length(root @ root.swapaxes(1, 2)), drawn, rtol=0.01)
    assert mean_length(np.zeros((1, 3, 3)))[0] < 1e-100


# Predicted accuracy


@pytest.mark.parametrize("name, channels", CASES)
def test_against_monte_carlo_of_linear_estimates(name, channels, robot):
    """Parameters drawn from their priors, measured with noise and estimated; then fresh poses, through the closed
    loops, of the error that is left. Where tilt alone is measured W's turn about gravity is void, and left out."""
    loaded = robot(name)
    model, n = loaded.model, 12
    parameters, random = model.parameters, np.random.default_rng(1)
    blocks = information(model, sites(loaded, n, 1), channels, loaded.description.sensor)
    fresh = sites(loaded, 25, 2)
    predicted = Probe.of(model, fresh, channels).accuracy(blocks)
    rows = blocks.reshape(-1, len(parameters))
    draws = 600
    truth = random.normal(size=(draws, len(parameters)))
    stacked = np.concatenate([rows, np.eye(len(parameters))])
    noisy = truth @ rows.T + random.normal(size=(draws, len(rows)))
    estimate = np.linalg.lstsq(stacked, np.concatenate([noisy, np.zeros_like(truth)], axis=1).T, rcond=None)[0].T
    left = (estimate - truth) * prior_sigma(parameters)
    left[:, np.abs(rows).max(axis=0) < 1e-9 * np.abs(rows).max()] = 0  # never seen
    small = 1e-2  # the errors are scaled down, so that they are linear in the parameters
    at_drawing = model.robot(np.zeros(len(parameters)))
    actual = at_drawing.measured(at_drawing.close(fresh.readings).pose)
    turned, moved = [], []
    for error in small * left:
        built = model.robot(error)
        pose = built.measured(built.close(fresh.readings, fresh.q).pose)
        angle = orientation_error if "orientation" in channels else gravity_error
        turned.append(np.linalg.norm(angle(actual.rotation, pose.rotation), axis=1) / small)
        moved.append(np.linalg.norm(pose.translation - actual.translation, axis=1) / small)
    turned, moved = np.rad2deg(turned), 1e3 * np.array(moved)
    assert predicted.mean_deg == pytest.approx(turned.mean(), rel=0.05)
    assert predicted.rms_deg == pytest.approx(np.sqrt(np.mean(turned**2)), rel=0.05)
    assert predicted.max_deg == pytest.approx(turned.mean(axis=0).max(), rel=0.12)
    if "position" in channels:
        assert predicted.mean_mm == pytest.approx(moved.mean(), rel=0.05)
        assert predicted.rms_mm == pytest.approx(np.sqrt(np.mean(moved**2)), rel=0.05)
    else:
        assert (predicted.mean_mm, predicted.rms_mm, predicted.max_mm) == (None, None, None)


def test_without_poses_the_priors_are_left(robot):
    """The tolerances and, for W and T, the width that stands for flat priors."""
    loaded = robot("ups3_s")
    probe = Probe.of(loaded.model, sites(loaded, 5, 1), ("orientation",))
    nothing = probe.accuracy(np.zeros((1, 3, len(loaded.model.parameters))))
    assert nothing.rms_deg == pytest.approx(np.rad2deg(FLAT * np.sqrt(6)), rel=0.01)


@pytest.mark.parametrize("name, channels", CASES)
def test_more_poses_are_never_worse(name, channels, robot):
    loaded = robot(name)
    probe = Probe.of(loaded.model, sites(loaded, 30, 1), channels)
    blocks = information(loaded.model, sites(loaded, 60, 3), channels, loaded.description.sensor)
    means = [probe.accuracy(blocks[:n]).mean_deg for n in (5, 10, 20, 40, 60)]
    assert np.all(np.diff(means) < 0)


@pytest.mark.parametrize(
    "channels, deg, mm",
    [(("yaw",), False, False), (("position",), False, True), (("tilt", "yaw"), True, False), (("tilt",), True, False)],
)
def test_what_is_not_measured_is_not_predicted(channels, deg, mm, robot):
    loaded = robot("jugglebot")
    blocks = information(loaded.model, sites(loaded, 10, 1), channels, loaded.description.sensor)
    found = Probe.of(loaded.model, sites(loaded, 10, 2), channels).accuracy(blocks)
    assert (found.mean_deg is not None, found.mean_mm is not None) == (deg, mm)
