"""Which poses to measure, and which of the measured ones to hold out."""

from __future__ import annotations

import numpy as np

from kincal.identification.registration import MIN_POSES
from kincal.urdf.description import Plan, Split, Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.workspace import grid, sample

_GRID_AXES = 3  # with more axes a grid has too few points along each


def planned(workspace: Workspace, axes: tuple[int, ...], plan: Plan, seed: int) -> np.ndarray:
    """Tool coordinates (n, 6): the uniform grid of the paper (150 poses: 5 x 5 x 6), or evenly spread random poses.

    Where n is no product of nearly equal counts, n poses are drawn from the smallest cubic grid that holds them, as in
    the paper's study of n. D-optimal poses need a model of the robot: see `d_optimal`.
    """
    layout = plan.layout or ("grid" if len(axes) <= _GRID_AXES else "random")
    if layout == "d_optimal":
        raise ValueError("planned: d_optimal poses come from identification.d_optimal")
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


def chosen(n: int, count: int, seed: int) -> np.ndarray:
    """Rows of n measured poses when only `count` are to be used; more are the same and others. Raises InputError."""
    if count > n:
        raise InputError(f"split.poses = {count}: there are {n} measured poses")
    return np.sort(np.random.default_rng([seed, 13]).permutation(n)[:count])


def travel_order(joints: np.ndarray, home: np.ndarray) -> np.ndarray:
    """(n,) an order of poses with joints (n, n_actuated) in which the machine travels little, from home (n_actuated,).

    The nearest neighbour, then 2-opt. A move takes as long as its longest joint, each in units of its own range.
    """
    points = np.concatenate([home[None], joints])
    points = points / np.maximum(np.ptp(points, axis=0), 1e-12)
    apart = np.zeros((len(points), len(points)))
    for column in points.T:
        apart = np.maximum(apart, np.abs(column[:, None] - column))
    route, left = [0], np.ones(len(points), dtype=bool)
    left[0] = False
    while left.any():
        route.append(int(np.argmin(np.where(left, apart[route[-1]], np.inf))))
        left[route[-1]] = False
    return _untangled(np.array(route), apart)[1:] - 1


def _untangled(route: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """2-opt of an open route: stretches are turned round as long as that makes it shorter."""
    shorter = True
    while shorter:
        shorter = False
        for i in range(len(route) - 2):
            before, first, last = route[i], route[i + 1], route[i + 2 :]
            after = np.append(route[i + 3 :], -1)  # behind the last pose the machine is free to stop
            old = apart[before, first] + np.append(apart[last[:-1], after[:-1]], 0.0)
            new = apart[before, last] + np.append(apart[first, after[:-1]], 0.0)
            best = int(np.argmin(new - old))
            if new[best] < old[best] - 1e-9:
                route[i + 1 : i + 3 + best] = route[i + 1 : i + 3 + best][::-1].copy()
                shorter = True
    return route


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
    return equal_parts(n, min(n, max(2, round(1 / split.test))), seed)


def equal_parts(n: int, k: int, seed: int) -> list[np.ndarray]:
    """Rows of n poses in k parts, drawn with the seed."""
    return [np.sort(part) for part in np.array_split(np.random.default_rng([seed, 4]).permutation(n), k)]
