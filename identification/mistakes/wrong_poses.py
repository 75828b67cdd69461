"""Some poses that do not fit the others, whatever is wrong with them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtri

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel, pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.linear import LinearRobot
from kincal.identification.mistakes.mistake import SOME_POSES, Mistake, numbered, of_rows
from kincal.identification.mistakes.registered import Registered, drawn_closure, registered

_ROUNDS = 6  # of trimming
_REWEIGHTED = 20  # times
MOST = 0.35  # of the poses, that may be wrong
_CHANCE = 1e-6  # that a good pose looks like a wrong one
_CAUTION = 1.5  # times the limit: residuals of good poses are not Gaussian where geometry can't explain all


def wrong_poses(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """The poses beyond what the others show, all parameters fitted robustly."""
    wrong = _wrong(model, measured)
    if wrong.any() and wrong.mean() <= MOST:
        do = "does" if wrong.sum() == 1 else "do"
        cause = f"{numbered(measured.pose[wrong])} {do} not fit the others"
        yield of_rows(cause, measured, wrong, general=SOME_POSES)


def _wrong(model: ErrorModel, measured: Measurements) -> np.ndarray:
    """(n,) bool. Raises InputError."""
    robot = LinearRobot.of(model, measured, _trimmed(model, measured))
    weights = np.ones(len(measured))
    wrong = np.zeros(len(measured), dtype=bool)
    for _ in range(_REWEIGHTED):
        lengths = robot.lengths(robot.solved(weights)[1])
        relative = [lengths[c.name] / _scale(lengths[c.name], c.rows) for c in named(measured.channels)]
        worst = np.max(relative, axis=0)  # in robust sigmas
        limits = [_CAUTION * np.sqrt(chdtri(c.rows, _CHANCE)) for c in named(measured.channels)]
        wrong = np.any([r > limit for r, limit in zip(relative, limits, strict=True)], axis=0)
        weights = 1 / (1 + (worst / 2.4) ** 2)  # Cauchy's, 95 % efficient
    return wrong


def _scale(lengths: np.ndarray, rows: int) -> float:
    """Sigma of one row by the median of the lengths; at least 1, the sensor's own."""
    return max(float(np.median(lengths)) / float(np.sqrt(chdtri(rows, 0.5))), 1.0)


def _trimmed(model: ErrorModel, measured: Measurements) -> Registered:
    """W and T of the best two thirds of the poses: least trimmed squares; residuals of all. Raises InputError."""
    closure, kept = drawn_closure(model, measured.readings), np.arange(len(measured))
    fewest = max(int((1 - MOST) * len(measured)), min(8, len(measured)))
    at = None
    for _ in range(_ROUNDS):
        at = registered(model, measured[kept], closure[kept], None if at is None else at.robot, quick=False)
        size = np.linalg.norm(pose_residual(at.robot.measured(closure.pose), measured), axis=1)
        before, kept = kept, np.sort(np.argsort(size)[:fewest])
        if np.array_equal(before, kept):
            break
    assert at is not None
    residual = pose_residual(at.robot.measured(closure.pose), measured)
    return Registered(at.robot, closure.q, closure.pose, residual)
