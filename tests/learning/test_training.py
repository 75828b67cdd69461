"""Levenberg-Marquardt and Adam over a batch of networks: derivatives, minima, early stopping, decay, independence."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from kincal.learning import training
from kincal.learning.first_order import adam
from kincal.learning.members import Problem
from kincal.learning.network import Network, Sizes, initial_weights
from kincal.learning.normal_equations import Dual, Primal, Rows, linearised
from kincal.learning.training import levenberg_marquardt


def network(sizes: Sizes, weights: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """The network of one input vector, written with nothing but torch's own functions."""
    parts, start = [], 0
    for n_in, n_out in ((sizes[0], sizes[1]), sizes[1:3], sizes[2:]):
        w = weights[start : start + n_in * n_out].view(n_out, n_in)
        b = weights[start + n_in * n_out : start + (n_in + 1) * n_out]
        parts.append((w, b))
        start += (n_in + 1) * n_out
    for w, b in parts[:2]:
        x = torch.tanh(torch.nn.functional.linear(x, w, b))
    return torch.nn.functional.linear(x, *parts[2])


def problem(batch: int, n: int, n_in: int, n_out: int, m: int | None, seed: int = 0) -> Problem:
    """Random tasks with row weights, some of them 0; m: rows of the gain, None for regression."""
    random = np.random.default_rng(seed)
    train = random.uniform(0.2, 2.0, (batch, n)) * (random.random((batch, n)) < 0.8)
    offset = random.normal(size=(batch, n, n_out if m is None else m))
    gain = None if m is None else random.normal(size=(batch, n, m, n_out))
    return Problem(random.uniform(-1, 1, (batch, n, n_in)), offset, gain, train, (train == 0).astype(float))


def random_start(sizes: Sizes, batch: int, seed: int = 0) -> np.ndarray:
    return np.stack([initial_weights(sizes, np.random.default_rng([seed, k])) for k in range(batch)])


@pytest.mark.parametrize("rows", [None, 5], ids=["regression", "gain"])
def test_normal_equations(rows, monkeypatch):
    """J^T W e, J^T W J, J W J^T and products with J, against J by torch's jacrev, mapped over poses and tasks."""
    sizes = (3, 4, 4, 2)
    task = problem(3, 7, sizes[0], sizes[3], rows)
    start = random_start(sizes, 3)
    weights, x, offset, train = (torch.from_numpy(v) for v in (start, task.x, task.offset, task.train))
    unit = torch.eye(sizes[3], dtype=torch.float64).expand(3, 7, -1, -1)
    gain = unit if task.gain is None else torch.from_numpy(task.gain)

    def error(w, x, offset, gain):
        return offset + gain @ network(sizes, w, x)

    over_poses = torch.vmap(torch.func.jacrev(error), (None, 0, 0, 0))
    jacobian = torch.vmap(over_poses)(weights, x, offset, gain)
    errors = torch.vmap(torch.vmap(error, (None, 0, 0, 0)))(weights, x, offset, gain)
    normal = torch.einsum("bn,bnmi,bnmj->bij", train, jacobian, jacobian)
    gradient = torch.einsum("bn,bnmi,bnm->bi", train, jacobian, errors)
    given = Rows.of(task.x, task.offset, task.gain, task.train)
    monkeypatch.setattr("kincal.learning.normal_equations._CHUNK", 3)  # so that there are several chunks
    for k, found in enumerate(Primal.of(weights, sizes, given)):
        close(found.normal, normal[k])
        close(found.gradient, gradient[k])
    root = train.sqrt()[:, :, None, None]
    for k, found in enumerate(Dual.of(weights, sizes, given)):
        rooted = (jacobian * root)[k].transpose(0, 1).flatten(0, 1)
        close(found.kernel, rooted @ rooted.T)
        close(found.times(weights[0]), rooted @ weights[0])
        close(found.transposed_times(found.error), gradient[k])


def close(found: torch.Tensor, expected: torch.Tensor) -> None:
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_reaches_the_minimum_of_scipy(seed):
    """The same problem by scipy's least_squares from the same start; a decay makes its minimum regular."""
    sizes = (1, 3, 3, 1)
    x = np.linspace(-1, 1, 30)[None, :, None]
    y = 0.8 * np.sin(2 * x) + 0.3
    start = random_start(sizes, 1, seed)
    task = Problem(x, -y, None, np.ones((1, 30)), np.zeros((1, 30)))
    found = levenberg_marquardt(task, sizes, start, iterations=500, patience=500, decay=np.array([0.1]))

    def residuals(w: np.ndarray) -> np.ndarray:
        at = Network(sizes, w, np.zeros(1), np.ones(1), np.ones(1))
        return np.concatenate([(at(x[0]) - y[0]).ravel(), np.sqrt(0.1) * (w - start[0])])

    expected = least_squares(residuals, start[0], xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert np.sum(residuals(found.weights[0]) ** 2) == pytest.approx(2 * expected.cost, rel=1e-6)
    assert found.train_loss[0] == pytest.approx(2 * expected.cost / 30, rel=1e-6)


def test_a_linear_problem_in_disguise():
    """Inputs so small that tanh is linear, a gain, row weights: the error left against linear least squares'."""
    random = np.random.default_rng(4)
    sizes = (2, 3, 3, 2)
    x = 1e-4 * random.uniform(-1, 1, (1, 50, 2))
    gain, weight = random.normal(size=(1, 50, 3, 2)), random.uniform(0.5, 2, (1, 50))
    offset = 1e-3 * random.normal(size=(1, 50, 3)) + gain[..., 0] * x[..., :1] * 0.1
    found = levenberg_marquardt(
        Problem(x, offset, gain, weight, np.zeros((1, 50))),
        sizes,
        random_start(sizes, 1),
        iterations=300,
        patience=300,
    )
    # y = A x + b: six unknowns
    inputs = np.concatenate([1e4 * x[0], np.ones((50, 1))], axis=1)
    root = np.sqrt(weight[0])[:, None]
    system = np.einsum("nmk,nj->nmkj", gain[0], inputs).reshape(50, 3, 6) * root[..., None]
    right = (offset[0] * root).reshape(150)
    left = np.linalg.lstsq(system.reshape(150, 6), -right, rcond=None)[1][0]
    assert found.train_loss[0] * weight.sum() == pytest.approx(left, rel=1e-4)


def test_a_network_is_found_again():
    """Outputs of a known network of the same size, from a start near by: the error falls to rounding."""
    sizes = (2, 3, 3, 2)
    true = random_start(sizes, 1)
    x = np.random.default_rng(1).uniform(-1, 1, (1, 60, 2))
    y = Network(sizes, true[0], np.zeros(2), np.ones(2), np.ones(2))(x[0])
    start = true + 0.05 * np.random.default_rng(2).normal(size=true.shape)
    task = Problem(x, -y[None], None, np.ones((1, 60)), np.zeros((1, 60)))
    assert levenberg_marquardt(task, sizes, start, iterations=100, patience=100).train_loss[0] < 1e-20


def test_a_gain_is_trained_through():
    """A network seen only through gains (two rows a pose, three outputs) against training on its outputs themselves."""
    random = np.random.default_rng(3)
    sizes = (2, 4, 4, 3)
    x = random.uniform(-1, 1, (1, 200, 2))
    y = np.stack([np.sin(x[..., 0]), x[..., 0] * x[..., 1], np.cos(x[..., 1])], axis=-1)
    gain = random.normal(size=(1, 200, 2, 3))
    offset = -(gain @ y[..., None])[..., 0]
    task = Problem(x, offset, gain, np.ones((1, 200)), np.zeros((1, 200)))
    found = levenberg_marquardt(task, sizes, random_start(sizes, 1), iterations=200, patience=200)
    fitted = Network(sizes, found.weights[0], np.zeros(2), np.ones(2), np.ones(3))(x[0])
    assert np.sqrt(np.mean((fitted - y[0]) ** 2)) < 0.01


def test_tasks_of_a_batch_know_nothing_of_each_other():
    """Three tasks at once against one at a time: damping, stopping and data are each task's own."""
    sizes = (3, 4, 4, 2)
    task, start = problem(3, 40, 3, 2, None), random_start(sizes, 3)
    decay = np.array([0.1, 1.0, 10.0])
    options = {"iterations": 15, "patience": 4}
    together = levenberg_marquardt(task, sizes, start, decay=decay, **options)
    for k in range(3):
        own = Problem(task.x[k : k + 1], task.offset[k : k + 1], None, task.train[k : k + 1], task.validate[k : k + 1])
        alone = levenberg_marquardt(own, sizes, start[k : k + 1], decay=decay[k : k + 1], **options)
        np.testing.assert_allclose(together.weights[k], alone.weights[0], rtol=0, atol=1e-9)
        assert together.validation_loss[k] == pytest.approx(alone.validation_loss[0], rel=1e-9)


def test_rows_of_weight_zero_are_not_there():
    """Against the problem without these rows, whatever nonsense stands in them."""
    sizes = (3, 4, 4, 2)
    task, start = problem(1, 40, 3, 2, None), random_start(sizes, 1)
    keep = task.train[0] > 0
    spoiled = np.where(keep[None, :, None], task.offset, 1e3)
    none = np.zeros((1, 40))
    decay = np.array([1.0])
    whole = Problem(task.x, spoiled, None, task.train, none)
    part = Problem(task.x[:, keep], task.offset[:, keep], None, task.train[:, keep], none[:, keep])
    one, other = (levenberg_marquardt(p, sizes, start, iterations=10, decay=decay) for p in (whole, part))
    np.testing.assert_allclose(one.weights, other.weights, rtol=0, atol=1e-9)


def test_twice_the_same():
    """Deterministic to the last bit."""
    sizes = (3, 6, 6, 2)
    one, other = (
        levenberg_marquardt(problem(2, 50, 3, 2, None), sizes, random_start(sizes, 2), iterations=20) for _ in "ab"
    )
    np.testing.assert_array_equal(one.weights, other.weights)
    np.testing.assert_array_equal(one.curve, other.curve)


@pytest.fixture
def overfitting() -> tuple[Sizes, Problem, np.ndarray]:
    """Two tasks of pure noise on a smooth line: few rows, many weights, so that validation gets worse in the end."""
    random = np.random.default_rng(5)
    sizes = (1, 8, 8, 1)
    x = random.uniform(-1, 1, (2, 40, 1))
    y = 0.5 * x + 0.3 * random.normal(size=x.shape)
    held = np.zeros((2, 40))
    held[:, 15:] = 1.0
    return sizes, Problem(x, -y, None, 1 - held, held), random_start(sizes, 2)


def test_early_stopping_returns_the_best_weights(overfitting):
    """The validation loss, calculated here from the weights returned, against the least of the curve."""
    sizes, task, start = overfitting
    found = levenberg_marquardt(task, sizes, start, iterations=60, patience=6)
    for k in range(2):
        fitted = Network(sizes, found.weights[k], np.zeros(1), np.ones(1), np.ones(1))
        error = (fitted(task.x[k]) + task.offset[k])[:, 0]
        first = (Network(sizes, start[k], np.zeros(1), np.ones(1), np.ones(1))(task.x[k]) + task.offset[k])[:, 0]
        curve = found.curve[:, 2 + k]
        assert np.mean(error[15:] ** 2) == pytest.approx(found.validation_loss[k], rel=1e-12)
        assert found.validation_loss[k] == pytest.approx(min(curve.min(), np.mean(first[15:] ** 2)), rel=1e-12)
        assert found.train_loss[k] == pytest.approx(np.mean(error[:15] ** 2), rel=1e-12)
        assert curve[-1] > 1.01 * curve.min()  # it did get worse


def test_early_stopping_waits_for_its_patience(overfitting):
    """It ends `patience` iterations after the last task's best, and before the limit."""
    sizes, task, start = overfitting
    found = levenberg_marquardt(task, sizes, start, iterations=200, patience=3)
    best = found.curve[:, 2:].argmin(axis=0)
    assert found.iterations == len(found.curve) < 200
    assert found.iterations <= best.max() + 1 + 3


def test_a_start_that_is_best_is_kept(overfitting):
    """A network that knows the truth of the validation rows, trained on others' nonsense: it comes back unchanged."""
    sizes, task, _ = overfitting
    start = random_start(sizes, 2)
    x = task.x
    y = np.stack([Network(sizes, w, np.zeros(1), np.ones(1), np.ones(1))(x[k]) for k, w in enumerate(start)])
    y[:, :15] += 1.0
    found = levenberg_marquardt(Problem(x, -y, None, task.train, task.validate), sizes, start, iterations=20)
    np.testing.assert_array_equal(found.weights, start)


def test_damping_that_is_raised_by_little_leads_further(monkeypatch):
    """Lower by far after as many iterations as with Marquardt's own 10 and 1 / 10, over random smooth tasks."""
    sizes, random = (3, 8, 8, 2), np.random.default_rng(0)
    x = random.uniform(-1, 1, (6, 300, 3))
    y = np.sin(x @ random.normal(size=(6, 3, 2)) + random.normal(size=(6, 1, 2)))
    task = Problem(x, -y, None, np.ones((6, 300)), np.zeros((6, 300)))
    ours = levenberg_marquardt(task, sizes, random_start(sizes, 6), iterations=60)
    for name, factor in (("_RAISED", 10.0), ("_LOWERED", 0.1), ("_AFTER_REFUSAL", 0.1)):
        monkeypatch.setattr(training, name, factor)
    usual = levenberg_marquardt(task, sizes, random_start(sizes, 6), iterations=60)
    assert np.log(usual.train_loss / ours.train_loss).mean() > np.log(10)


def test_decay_pulls_to_the_start(overfitting):
    """The stronger, the nearer: and with an overwhelming one the weights stay."""
    sizes, task, start = overfitting
    free = Problem(task.x, task.offset, None, task.train, np.zeros_like(task.validate))
    moved = []
    for decay in (0.01, 1.0, 100.0, 1e9):
        found = levenberg_marquardt(free, sizes, start, iterations=200, patience=200, decay=np.full(2, decay))
        moved.append(np.linalg.norm(found.weights - start, axis=1).max())
    assert all(later < earlier for earlier, later in pairwise(moved))
    assert moved[-1] < 1e-6


@pytest.mark.parametrize("spoiled", ["x", "offset", "start"])
def test_what_is_no_number_is_an_error(spoiled):
    """A NaN at the start ends in FloatingPointError, not in weights."""
    sizes = (3, 4, 4, 2)
    task, start = problem(2, 10, 3, 2, None), random_start(sizes, 2)
    {"x": task.x, "offset": task.offset}.get(spoiled, start).flat[-1] = np.nan
    with pytest.raises(FloatingPointError):
        levenberg_marquardt(task, sizes, start, iterations=3)


def alone(task: Problem, k: int) -> Problem:
    """Member k's problem."""
    own = slice(k, k + 1)
    gain = None if task.gain is None else task.gain[own]
    return Problem(task.x[own], task.offset[own], gain, task.train[own], task.validate[own])


@pytest.mark.parametrize("trainer", [levenberg_marquardt, adam], ids=["lm", "adam"])
@pytest.mark.parametrize("rows", [None, 5], ids=["regression", "gain"])
@pytest.mark.parametrize("n", [12, 90], ids=["fewer rows than weights", "more"])
def test_ten_at_once_are_ten_in_a_row(trainer, rows, n):
    """Each with other data, numbers of rows, decay and end: weights, losses and curves, to 1e-9."""
    sizes = (3, 5, 5, 2)
    task, start, decay = problem(10, n, 3, 2, rows), random_start(sizes, 10), np.geomspace(1e-3, 10, 10)
    options = {"iterations": 40, "patience": 3}
    together = trainer(task, sizes, start, decay=decay, **options)
    ends = []
    for k in range(10):
        one = trainer(alone(task, k), sizes, start[k : k + 1], decay=decay[k : k + 1], **options)
        np.testing.assert_allclose(together.weights[k], one.weights[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(together.curve[: one.iterations, [k, 10 + k]], one.curve, rtol=1e-9)
        assert (together.curve[one.iterations :, [k, 10 + k]] == together.curve[one.iterations - 1, [k, 10 + k]]).all()
        assert together.train_loss[k] == pytest.approx(one.train_loss[0], rel=1e-9)
        ends.append(one.iterations)
    assert together.iterations == max(ends)
    assert len(set(ends)) > 1  # they did not all stop together


def test_both_forms_take_the_same_step():
    """Fewer rows than weights: by J J^T and by J^T J, at several dampings, with and without a pull."""
    sizes = (3, 6, 6, 3)
    task = problem(2, 8, 3, 3, 4)
    weights = torch.from_numpy(random_start(sizes, 2))
    given = Rows.of(task.x, task.offset, task.gain, task.train + 0.1)
    away = weights - torch.from_numpy(random_start(sizes, 2, seed=1))
    for one, other in zip(Primal.of(weights, sizes, given), Dual.of(weights, sizes, given), strict=True):
        for damping, pull in ((1e-1, 0.0), (1e-6, 0.0), (1e-3, 2.0), (1e-9, 1e-2)):
            by_weights, by_rows = one.step(damping, pull, away[0]), other.step(damping, pull, away[0])
            assert by_weights is not None
            assert by_rows is not None
            torch.testing.assert_close(by_weights, by_rows, rtol=1e-6, atol=1e-8)


def test_who_has_stopped_is_computed_no_further(monkeypatch):
    """A member at its minimum beside one that is far from it: linearisations are counted."""
    counted = []

    def count_members(weights, *others):
        counted.append(len(weights))
        return linearised(weights, *others)

    monkeypatch.setattr("kincal.learning.training.linearised", count_members)
    sizes = (2, 3, 3, 2)
    true = random_start(sizes, 2)
    x = np.random.default_rng(1).uniform(-1, 1, (2, 60, 2))
    y = np.stack([Network(sizes, w, np.zeros(2), np.ones(2), np.ones(2))(at) for w, at in zip(true, x, strict=True)])
    start = np.stack([true[0] + 1e-6, random_start(sizes, 1, seed=3)[0]])
    found = levenberg_marquardt(
        Problem(x, -y, None, np.ones((2, 60)), np.zeros((2, 60))), sizes, start, iterations=30, patience=30
    )
    assert found.train_loss[0] < 1e-20
    assert counted[0] == 2
    assert counted[-1] == 1
    assert sum(counted) < 1.7 * found.iterations


def test_a_refused_step_keeps_its_linearisation(monkeypatch):
    """Every linearisation but the first follows a step that led down: as many as iterations, whatever was refused."""
    counted, tried = [], []
    monkeypatch.setattr(
        "kincal.learning.training.linearised", lambda w, *others: counted.append(len(w)) or linearised(w, *others)
    )
    squares = Rows.squares
    monkeypatch.setattr(Rows, "squares", lambda *given: tried.append(len(given[1])) or squares(*given))
    sizes = (3, 6, 6, 2)
    task = problem(1, 60, 3, 2, None)
    task = Problem(task.x, task.offset, None, np.ones((1, 60)), np.zeros((1, 60)))
    found = levenberg_marquardt(task, sizes, 4 * random_start(sizes, 1), iterations=25, patience=25)
    assert sum(counted) == found.iterations == 25
    assert sum(tried) > 1 + 25  # the start, and at least one refused
    assert np.all(np.diff(found.curve[:, 0]) < 0)


def test_no_number_in_training_is_a_refused_step(monkeypatch):
    """Every third trial of one member is NaN: it gets there all the same, and the other does not notice."""
    sizes = (2, 4, 4, 2)
    task, start = problem(2, 60, 2, 2, None), random_start(sizes, 2)
    task = Problem(task.x, task.offset, None, np.ones((2, 60)), np.zeros((2, 60)))
    decay, calls, squares = np.full(2, 20.0), [], Rows.squares
    expected = levenberg_marquardt(task, sizes, start, iterations=100, patience=100, decay=decay)

    def spoiled(*given):
        calls.append(squares(*given))
        if len(calls) % 3 == 2 and len(calls[-1]) == 2:
            calls[-1][0] = np.nan
        return calls[-1]

    monkeypatch.setattr(Rows, "squares", spoiled)
    found = levenberg_marquardt(task, sizes, start, iterations=100, patience=100, decay=decay)
    np.testing.assert_array_equal(found.weights[1], expected.weights[1])
    assert found.train_loss[0] == pytest.approx(expected.train_loss[0], rel=1e-8)
    assert np.isfinite(found.curve[:, :2]).all()


def test_rows_of_weight_zero_may_be_no_numbers():
    """They are not there; and a member without any rows comes back as it was."""
    sizes = (3, 4, 4, 2)
    task, start = problem(2, 40, 3, 2, None), random_start(sizes, 2)
    train = task.train.copy()
    train[1] = 0.0
    task.offset[(train == 0) & (task.validate == 0)] = np.nan
    found = levenberg_marquardt(Problem(task.x, task.offset, None, train, task.validate), sizes, start, iterations=5)
    assert np.isfinite(found.weights).all()
    assert np.isfinite(found.train_loss[0])
    np.testing.assert_array_equal(found.weights[1], start[1])


def test_adam_reaches_levenberg_marquardt():
    """The same regular minimum (a decay) from the same start."""
    sizes = (2, 4, 4, 2)
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, (2, 80, 2))
    y = np.stack([np.sin(2 * x[..., 0]), x[..., 0] * x[..., 1]], axis=-1) + 0.1 * random.normal(size=x.shape)
    task = Problem(x, -y, None, random.uniform(0.5, 2, (2, 80)), np.zeros((2, 80)))
    start, decay = random_start(sizes, 2), np.full(2, 20.0)
    expected = levenberg_marquardt(task, sizes, start, iterations=200, patience=200, decay=decay)
    found = adam(task, sizes, start, iterations=1000, decay=decay)
    np.testing.assert_allclose(found.train_loss, expected.train_loss, rtol=1e-6)
    np.testing.assert_allclose(found.weights, expected.weights, atol=1e-3)


def test_adam_on_a_linear_problem():
    """Inputs so small that tanh is linear and outputs nearly constant: the mean of each is what is left to learn."""
    random = np.random.default_rng(4)
    sizes = (2, 3, 3, 2)
    x, offset = 1e-6 * random.uniform(-1, 1, (1, 50, 2)), random.normal(size=(1, 50, 2))
    weight = random.uniform(0.5, 2, (1, 50))
    found = adam(Problem(x, offset, None, weight, np.zeros((1, 50))), sizes, random_start(sizes, 1), iterations=800)
    fitted = Network(sizes, found.weights[0], np.zeros(2), np.ones(2), np.ones(2))(x[0])
    expected = -np.average(offset[0], axis=0, weights=weight[0])
    np.testing.assert_allclose(fitted, np.tile(expected, (50, 1)), atol=1e-4)


def test_adam_stops_early_and_returns_the_best(overfitting):
    """The validation loss calculated here from the weights returned is the least of the curve; twice the same."""
    sizes, task, start = overfitting
    found, again = (adam(task, sizes, start, iterations=3000, patience=100) for _ in "ab")
    for k in range(2):
        fitted = Network(sizes, found.weights[k], np.zeros(1), np.ones(1), np.ones(1))
        held = np.mean((fitted(task.x[k]) + task.offset[k])[15:] ** 2)
        assert held == pytest.approx(found.validation_loss[k], rel=1e-12)
        assert held <= found.curve[:, 2 + k].min() * (1 + 1e-12)
    assert found.iterations == len(found.curve) < 3000
    np.testing.assert_array_equal(found.weights, again.weights)


def test_adam_refuses_nan():
    sizes = (3, 4, 4, 3)
    task, start = problem(1, 40, 3, 3, None), random_start(sizes, 1)
    task.offset[:] = np.nan
    with pytest.raises(FloatingPointError):
        adam(task, sizes, start, iterations=3)
