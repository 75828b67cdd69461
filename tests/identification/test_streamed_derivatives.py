"""Many poses: factors streamed over chunks, derivatives compiled where that pays, and without a compiler."""

from __future__ import annotations

import numpy as np
import pytest

from kincal.identification import compiled as compilation
from kincal.identification import error_model
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.robust_loss import Loss

CHANNELS = ("orientation", "position")


@pytest.fixture
def measured(robot):
    loaded = robot("rps3")
    p = loaded.random_parameters(3)
    return loaded, loaded.measure(p, loaded.readings(47, 3), CHANNELS, noise=np.random.default_rng(3))


def test_factors_streamed_over_chunks_are_those_of_all_poses_at_once(measured, monkeypatch):
    loaded, poses = measured
    p = loaded.random_parameters(3) * 0.9
    loss = Loss("huber")
    jacobian = loaded.model.jacobian(p, poses)
    monkeypatch.setattr(error_model, "_CHUNK", 10)  # the last chunk is smaller
    at = loaded.model.linearise(p, poses, weigh=lambda r: loss.weights(r, CHANNELS))
    block = np.concatenate([jacobian, at.residual[..., None]], axis=2)
    block *= np.sqrt(loss.weights(at.residual, CHANNELS))[..., None]
    whole = block.reshape(-1, block.shape[-1])
    scale = np.linalg.norm(whole, axis=0)
    np.testing.assert_allclose(at.triangle.T @ at.triangle, whole.T @ whole, atol=1e-12 * np.outer(scale, scale).max())
    assert at.triangle.shape[0] <= block.shape[-1]


def test_an_identification_in_chunks_is_the_same(measured, monkeypatch):
    loaded, poses = measured
    whole = estimate_parameters(loaded.model, poses)
    monkeypatch.setattr(error_model, "_CHUNK", 9)
    parts = estimate_parameters(loaded.model, poses)
    sigma = np.sqrt(np.diag(whole.covariance)) + 1e-12
    assert np.max(np.abs(parts.p - whole.p) / sigma) < 1e-3
    np.testing.assert_allclose(parts.cost, whole.cost, rtol=1e-9)


def test_compiled_derivatives_are_the_interpreted_ones_and_are_kept(measured, tmp_path, monkeypatch):
    if compilation.shutil.which("cc") is None:
        pytest.skip("this machine has no C compiler")
    loaded, poses = measured
    p = loaded.random_parameters(3)
    interpreted = error_model._symbolic(loaded.chain, CHANNELS, True)
    library = compilation.compiled(interpreted, tmp_path)
    assert library.class_name() != interpreted.class_name()
    (file,) = tmp_path.glob("*.so")
    stamp = file.stat().st_mtime_ns
    compilation.compiled(interpreted, tmp_path)
    assert file.stat().st_mtime_ns == stamp, "compiled again"
    robot = loaded.model.robot(p)
    q = robot.close(poses.readings).q
    expected = error_model._Batched(interpreted)(robot, q, poses)
    for one, other in zip(expected, error_model._Batched(library)(robot, q, poses), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())


@pytest.mark.parametrize("what", ["no compiler", "a compiler that fails", "a broken library", "no place to keep it"])
def test_without_a_compiled_library_the_interpreter_does(what, measured, tmp_path, monkeypatch):
    loaded, _ = measured
    function = error_model._symbolic(loaded.chain, CHANNELS, False)
    folder = tmp_path / "cache"
    if what == "no compiler":
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.setattr(compilation.shutil, "which", lambda name: None)
    elif what == "a compiler that fails":
        monkeypatch.setenv("CC", "false")
    elif what == "a broken library":
        monkeypatch.setattr(compilation, "_compile", lambda compiler, source, library: _broken(library))
    else:
        folder.write_text("a file stands where the folder should be")
    assert compilation.compiled(function, folder) is function
    assert not list(tmp_path.rglob("*.c"))


def _broken(library) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    library.write_bytes(b"not a library")


def test_many_poses_are_compiled_and_few_are_not(measured, monkeypatch):
    loaded, poses = measured
    asked = []
    monkeypatch.setattr(error_model, "compiled", lambda function: asked.append(function) or function)
    model = error_model.ErrorModel.of(loaded.chain, loaded.description.actuator, loaded.description.tolerance)
    register(model, poses)
    assert not asked
    monkeypatch.setattr(error_model, "PAYS", len(poses))
    register(model, poses)
    assert len(asked) == 1


def test_singular_values_where_the_fast_driver_gives_up(monkeypatch):
    from kincal.identification.singular_values import svd

    matrix = np.random.default_rng(1).normal(size=(9, 5))
    expected = np.sqrt(np.linalg.eigvalsh(matrix.T @ matrix))[::-1]

    def gives_up(*args, **options):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", gives_up)
    u, singular, vt = svd(matrix)
    np.testing.assert_allclose(singular, expected, rtol=1e-12)
    np.testing.assert_allclose(u * singular @ vt, matrix, atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        svd(np.full((3, 3), np.nan))
