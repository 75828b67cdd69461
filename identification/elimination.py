"""Sparse linear systems solved in symbols: Gaussian elimination with an order of pivots that is chosen once.

Generated code can't choose its pivots where it runs. They are chosen by Markowitz's rule (1957, Management Science 3)
among those that are not small in their columns at any of the given sample matrices.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

_SMALL = 0.1  # of the largest in its column: what a pivot may be at no sample, if another one may not


def eliminate(matrix: ca.SX, right: ca.SX, samples: np.ndarray) -> tuple[ca.SX, ca.SX]:
    """x (n, m) with matrix (n, n) @ x = right (n, m), and the determinant of the matrix.

    samples: (k, n, n), values of the matrix where it will be solved.
    """
    n, numbers = matrix.shape[0], np.array(samples, dtype=float)
    matrix = ca.sparsify(matrix)
    rows: list[dict[int, ca.SX]] = [{} for _ in range(n)]
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        rows[i][j] = matrix[i, j]
    values, determinant = [right[i, :] for i in range(n)], ca.SX(1)
    left, order = set(range(n)), []
    for _ in range(n):
        i, j = _pivot(rows, left, numbers)
        left.remove(i)
        order.append((i, j))
        determinant *= rows[i][j]
        inverse = 1 / rows[i][j]
        for k in [k for k in left if j in rows[k]]:
            factor = rows[k].pop(j) * inverse
            ratio = numbers[:, k, j] / numbers[:, i, j]
            values[k] -= factor * values[i]
            numbers[:, k] -= ratio[:, None] * numbers[:, i]
            numbers[:, k, j] = 0.0
            for column, value in rows[i].items():
                if column != j:
                    rows[k][column] = rows[k].get(column, ca.SX(0)) - factor * value
    x = [ca.SX(1, right.shape[1])] * n
    for i, j in reversed(order):
        known = sum((value * x[k] for k, value in rows[i].items() if k != j), ca.SX(1, right.shape[1]))
        x[j] = (values[i] - known) / rows[i][j]
    return ca.vertcat(ca.SX(0, right.shape[1]), *x), determinant * _sign(order)


def _pivot(rows: list[dict[int, ca.SX]], left: set[int], numbers: np.ndarray) -> tuple[int, int]:
    """The entry with the least fill-in of those that are large enough; else the largest in its column."""
    among = sorted(left)
    largest = np.abs(numbers[:, among]).max(axis=1)
    counts: dict[int, int] = {}
    for i in among:
        for j in rows[i]:
            counts[j] = counts.get(j, 0) + 1

    def worth(entry: tuple[int, int]) -> tuple[bool, float, float]:
        i, j = entry
        size = float((np.abs(numbers[:, i, j]) / np.maximum(largest[:, j], 1e-300)).min())
        fill = (len(rows[i]) - 1) * (counts[j] - 1)
        return (True, -fill, size) if size >= _SMALL else (False, size, 0.0)

    return max(((i, j) for i in among for j in sorted(rows[i])), key=worth)


def _sign(order: list[tuple[int, int]]) -> float:
    """Of the permutation that takes each pivot's row to its column."""
    permutation = np.zeros((len(order), len(order)))
    for i, j in order:
        permutation[i, j] = 1.0
    return float(np.sign(np.linalg.det(permutation)))
