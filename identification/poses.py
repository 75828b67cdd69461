"""Which poses to measure, and which of the measured ones to hold out."""

from __future__ import annotations

import numpy as np

from identification.registration import MIN_POSES
from urdf.description import Plan, Split, Workspace
from urdf.errors import InputError
from urdf.workspace import grid, sample

_GRID_AXES = 3  # with more axes a grid has too few points along each


def planned(workspace: Workspace, axes: tuple[int, ...], plan: Plan, seed: int) -> np.ndarray:
    """Tool coordinates (n, 6): the uniform grid of the paper (150 poses: 5 x 5 x 6), or evenly spread random poses.

    Where n is no product of nearly equal counts, n poses are drawn from the smallest cubic grid that holds them, as in
    the paper's study of n.
    """
    layout = plan.layout or ("grid" if len(axes) <= _GRID_AXES else "random")
    if layout == "random":
        return sample(workspace, axes, plan.poses, seed, even=True)
    counts = _factors(plan.poses, len(axes))
    if counts is not None:
        return grid(workspace, axes, counts)
    side = int(np.ceil(plan.poses ** (1 / len(axes)) - 1e-9))
    points = grid(workspace, axes, [side] * len(axes))
    drawn = np.random.default_rng([seed, 3]).choice(len(points), plan.poses, replace=False)
    return points[np.sort(drawn)]


def _factors(n: int, k: int) -> list[int] | None:
    """n as a product of k counts that differ by one at most, ascending; None where there is none."""
    side = int(np.floor(n ** (1 / k) + 1e-9))
    for larger in range(k):
        if side > 1 and side ** (k - larger) * (side + 1) ** larger == n:
            return [side] * (k - larger) + [side + 1] * larger
    return None


def held_out(n: int, split: Split, seed: int) -> np.ndarray:
    """(k,) the rows of n measured poses to score on, drawn with the seed. Raises InputError where too few remain."""
    k = max(1, round(split.test * n))
    if n - k < MIN_POSES:
        raise InputError(
            f"measurements: {n} poses less {k} for testing (split.test = {split.test:g}) leave {n - k} to train on; "
            f"at least {MIN_POSES} are needed"
        )
    return np.sort(np.random.default_rng([seed, 4]).permutation(n)[:k])


def folds(n: int, split: Split, seed: int) -> list[np.ndarray]:
    """1 / test folds of n measured poses for cross-validation: each pose in one of them."""
    k = min(n, max(2, round(1 / split.test)))
    return [np.sort(part) for part in np.array_split(np.random.default_rng([seed, 4]).permutation(n), k)]
