"""The residual network on synthetic errors: what is there is learned beside the model, noise is not."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from kincal.learning.correction import Correction
from kincal.learning.network import Network, initial_weights
from kincal.learning.residual import Task, fit_correction, learning_curve, refit
from kincal.learning.units import STRUCTURES, Inherited

JOINTS, ROWS = 3, 4
LOW, HIGH = np.array([0.4, 0.35, 0.5]), np.array([0.6, 0.55, 0.52])  # ranges of different size
OPTIONS = {"own": 8, "shared": 12, "seed": 0}
SIGMA = 1e-5
TRUE_Z = np.random.default_rng(5).normal(size=11)


def joints(n: int, seed: int) -> np.ndarray:
    return LOW + (HIGH - LOW) * np.random.default_rng([seed, 1]).random((n, JOINTS))


def smooth(x: np.ndarray) -> np.ndarray:
    """An error of each joint, and a load that couples them."""
    u = 2 * (x - LOW) / (HIGH - LOW) - 1
    return 3e-4 * (np.sin(2 * u) + 0.5 * u**2) + 1e-4 * (u[:, [1, 2, 0]] * u[:, [2, 0, 1]])


def screw(x: np.ndarray) -> np.ndarray:
    """A periodic error of the first joint, 5.3 cycles over its range."""
    found = np.zeros_like(x)
    found[:, 0] = 2e-4 * np.sin(2 * np.pi * 5.3 * (x[:, 0] - LOW[0]) / (HIGH[0] - LOW[0]) + 1.0)
    return found


def nothing(x: np.ndarray) -> np.ndarray:
    return np.zeros_like(x)


def derivatives(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the errors by eleven parameters, six of which look like the network's functions, and by the outputs."""
    u = 2 * (x - LOW) / (HIGH - LOW) - 1
    random = np.random.default_rng(7)
    by_output = (random.normal(size=(ROWS, JOINTS)) + 0.2 * np.sin(u)[:, None, :]) / SIGMA
    zeros, gains = 1e-3 * by_output, 3e-4 * by_output * u[:, None, :]
    other = 2 * (random.normal(size=(ROWS, 5)) + np.sin(u @ random.normal(size=(JOINTS, 5)))[:, None, :])
    return np.concatenate([zeros, gains, other], axis=2), by_output


def task(n: int, seed: int, delta, noise: float = 1.0) -> Task:
    """e = r + J z + G delta is noise alone at the true z and delta."""
    x = joints(n, seed)
    by_model, by_output = derivatives(x)
    error = noise * np.random.default_rng(seed).normal(size=(n, ROWS))
    error = error - by_model @ TRUE_Z - (by_output @ delta(x)[..., None])[..., 0]
    return Task(x, error, by_model, by_output)


def inherited() -> Inherited:
    """Four smooth functions of all joints."""
    sizes = (JOINTS, 6, 6, 4)
    weights = initial_weights(sizes, np.random.default_rng(8))
    return Inherited(Network(sizes, weights, (LOW + HIGH) / 2, (HIGH - LOW) / 2, np.ones(4)), np.ones((4, 3)))


def parts(n: int) -> list[np.ndarray]:
    return np.array_split(np.random.default_rng(n).permutation(n), 10 if n > 20 else n)


@dataclass(frozen=True)
class Fitted:
    correction: Correction
    z: np.ndarray
    alone: np.ndarray  # z by least squares of the model alone, with its priors
    task: Task


def fitted(n: int, seed: int, delta) -> Fitted:
    own = task(n, seed, delta)
    flat = own.by_model.reshape(-1, len(TRUE_Z))
    alone = -np.linalg.solve(flat.T @ flat + np.eye(len(TRUE_Z)), flat.T @ own.error.ravel())
    return Fitted(*fit_correction(own, parts(n), inherited(), **OPTIONS), alone, own)


def unseen(found: Fitted, delta, z: np.ndarray | None = None) -> float:
    """Root mean square error, in sigmas, of predictions at fresh inputs: with the correction, or by z alone."""
    x = joints(400, seed=99)
    x = x[found.correction.fade(x) == 1]
    by_model, by_output = derivatives(x)
    own = found.correction(x) if z is None else 0.0
    left = by_model @ ((found.z if z is None else z) - TRUE_Z) + (by_output @ (own - delta(x))[..., None])[..., 0]
    return float(np.sqrt(np.mean(left**2)))


@pytest.fixture(scope="module")
def learned() -> Fitted:
    return fitted(120, 1, smooth)


def test_residual_and_geometry_are_found_together(learned):
    """Planted both: predictions of fresh poses are better than one measurement, and far better than by z alone."""
    assert learned.correction.shrinkage > 0.9
    assert learned.correction.evidence > 5
    assert unseen(learned, smooth) < 1.0
    assert unseen(learned, smooth) < 0.2 * unseen(learned, smooth, learned.alone)


def test_neither_takes_what_is_the_others(learned):
    """Parameters beside the actuators', which no function of the joints imitates, predict better what they do."""
    by_model, _ = derivatives(joints(400, seed=99))
    own, alone = (np.mean((by_model[..., 6:] @ (z - TRUE_Z)[6:]) ** 2) for z in (learned.z, learned.alone))
    assert own < 0.25 * alone


def test_a_periodic_error_is_found():
    """Joint, period in readings and amplitude; a structure with waves is taken, and others lose."""
    found = fitted(120, 2, screw)
    correction = found.correction
    assert "periodic" in correction.structure or correction.structure == "all"
    near = [wave for wave in correction.waves() if wave[1] == pytest.approx((HIGH[0] - LOW[0]) / 5.3, rel=0.05)]
    assert correction.waves()[0] in near
    assert {joint for joint, *_ in near} == {0}
    assert sum(amplitude for *_, amplitude in near) == pytest.approx(2e-4, rel=0.1)  # of neighbours that share it
    assert unseen(found, screw) < 0.8
    assert correction.losses["periodic"] < correction.losses["each joint its own"] < correction.losses[""]


def test_the_structure_of_least_loss_is_taken(learned):
    losses = learned.correction.losses
    tried = {name: loss for name, loss in losses.items() if name}
    assert set(tried) <= set(STRUCTURES)
    assert tried[learned.correction.structure] == min(tried.values()) < losses[""]


def test_twice_the_same(learned):
    """Deterministic to the last bit."""
    again = fitted(120, 1, smooth)
    np.testing.assert_array_equal(again.correction.readout, learned.correction.readout)
    np.testing.assert_array_equal(again.z, learned.z)
    assert again.correction.shrinkage == learned.correction.shrinkage


def test_the_unit_of_the_outputs_does_not_matter(learned):
    """Outputs in units a thousand times as small: the same function, in that unit."""
    other = replace(learned.task, by_output=learned.task.by_output / 1e3)
    found, z = fit_correction(other, parts(120), inherited(), **OPTIONS)
    x = joints(50, seed=3)
    np.testing.assert_allclose(found(x), 1e3 * learned.correction(x), rtol=0, atol=1e-6 * 1e3 * 3e-4)
    np.testing.assert_allclose(z, learned.z, rtol=0, atol=1e-6)


def test_refit_at_the_same_task_changes_nothing(learned):
    again, z = refit(learned.correction, learned.task)
    np.testing.assert_allclose(z, learned.z, rtol=0, atol=1e-9)
    np.testing.assert_allclose(again.readout, learned.correction.readout, rtol=0, atol=1e-9)
    assert again.shrinkage == learned.correction.shrinkage


@pytest.mark.parametrize("n", [10, 50])
def test_noise_is_not_learned(n):
    """Nothing to learn: exactly zero, in all of ten seeds."""
    assert [fitted(n, seed, nothing).correction.shrinkage for seed in range(10)] == [0.0] * 10


def test_the_fewer_poses_the_less_is_believed():
    """At six poses nothing or little, at sixty nearly all; and the error never exceeds the model's own by a fifth."""
    found = [fitted(n, 3, smooth) for n in (6, 15, 60)]
    assert found[2].correction.shrinkage > 0.8
    for own in found:
        x = joints(400, seed=98)
        by_model, by_output = derivatives(x)
        share = own.correction.share(x)[:, None]
        refined = by_model @ (own.z - TRUE_Z) + (by_output @ (own.correction(x) - smooth(x))[..., None])[..., 0]
        alone = by_model @ (own.alone - TRUE_Z) - (by_output @ smooth(x)[..., None])[..., 0]
        mixed = share * refined + (1 - share) * alone
        assert np.sqrt(np.mean(mixed**2)) < 1.2 * np.sqrt(np.mean(alone**2))


@pytest.mark.parametrize("n", [3, 4, 8])
@pytest.mark.parametrize("delta", [nothing, smooth, screw])
def test_a_handful_of_poses_gives_numbers(n, delta):
    own = fitted(n, 0, delta)
    assert np.isfinite(own.z).all()
    assert np.isfinite(own.correction(joints(50, seed=3))).all()
    assert 0.0 <= own.correction.shrinkage <= 1.0
    assert np.isfinite(learning_curve(own.task, own.correction, 0)).all()
    x = joints(5, 4)
    by_model, by_output = derivatives(x)
    units = by_output @ own.correction.by_weights(x)
    covariance = own.correction.refined.of(by_model, by_output * own.correction.scale, units)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9 * covariance.max()


def test_a_joint_that_never_moves():
    """A clear result: numbers everywhere, and the others' errors are learned."""
    own = task(80, 6, smooth)
    still = own.x.copy()
    still[:, 1] = 0.4
    by_model, by_output = derivatives(still)
    error = np.random.default_rng(6).normal(size=(80, ROWS)) - by_model @ TRUE_Z
    error = error - (by_output @ smooth(still)[..., None])[..., 0]
    found, z = fit_correction(Task(still, error, by_model, by_output), parts(80), None, **OPTIONS)
    assert np.isfinite(z).all()
    assert np.isfinite(found(still)).all()
    assert found.shrinkage > 0.5
    assert np.all(found.share(still) == found.shrinkage)
    moved = still + np.array([0.0, 5.0, 0.0])
    assert np.all(found.share(moved) == 0)  # a joint value that was never seen is outside


def test_nothing_to_inherit(learned):
    """Structures that need it are not tried."""
    found, _ = fit_correction(learned.task, parts(120), None, **OPTIONS)
    assert len(found.losses) > 2
    assert not any("inherited" in name for name in found.losses)


# The learning curve


def test_learning_curve():
    """Parts of the poses, ascending; with the correction the error falls with their number, the model's stays."""
    own = fitted(120, 8, smooth)
    curve = learning_curve(own.task, own.correction, 0)
    np.testing.assert_array_equal(curve[:, 0], [48, 66, 84, 102])
    assert curve[-1, 2] < curve[0, 2]
    assert np.all(curve[:, 2] < 0.3 * curve[:, 1])
    # a whole pose's error, whose rows are ROWS, by the rows' own
    assert curve[-1, 1] == pytest.approx(np.sqrt(ROWS) * unseen(own, smooth, own.alone), rel=0.3)
    assert len(learning_curve(task(6, 0, smooth), fitted(6, 0, smooth).correction, 0)) == 0
