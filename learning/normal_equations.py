"""The linearised training problem: min |e + J s|^2 + strength |s|^2 by its normal equations, never forming J.

For pose n and row m of the error, d e / d W = t z^T in each layer: t (m, units) what reaches the layer's units from the
error, z (inputs) what they see, 1 for the bias. So J^T J is made of sums over poses of (t^T t)_ij (z z^T)_ab, symmetric
in ij and in ab: 8 times fewer products than J^T J itself for 3-16-16-3. And J J^T is, layer by layer, (t t^T) (z z^T).

Arrays have poses last: a pair of units is then a row, and rows are cheap to choose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import torch
from scipy.linalg import get_lapack_funcs
from torch import Tensor

from kincal.learning.network import Sizes, split

(_posv,) = get_lapack_funcs(("posv",), dtype=np.float64)
_CHUNK = 512  # poses at a time, of one member or of several: what is made of more falls out of the caches


@dataclass(frozen=True)
class Rows:
    """Weighted rows of g members: error = offset + gain @ net(x)."""

    x: Tensor  # (g, n_in, n)
    offset: Tensor  # (g, m, n)
    gain: Tensor | None  # (g, m, n_out, n); None: the identity
    weight: Tensor  # (g, n), none of them 0

    @staticmethod
    def of(x: np.ndarray, offset: np.ndarray, gain: np.ndarray | None, weight: np.ndarray) -> Rows:
        """From arrays with poses first: x (g, n, n_in), offset (g, n, m), gain (g, n, m, n_out), weight (g, n)."""
        return Rows(_poses_last(x), _poses_last(offset), None if gain is None else _poses_last(gain), _tensor(weight))

    def __getitem__(self, member: Tensor | slice) -> Rows:
        return Rows(
            self.x[member],
            self.offset[member],
            None if self.gain is None else self.gain[member],
            self.weight[member],
        )

    def poses(self, block: slice) -> Rows:
        gain = None if self.gain is None else self.gain[..., block]
        return Rows(self.x[..., block], self.offset[..., block], gain, self.weight[..., block])

    def errors(self, weights: Tensor, sizes: Sizes) -> Tensor:
        """(g, m, n) at weights: (g, n_weights)."""
        return self.through(forward(weights, sizes, self.x)[-1])

    def squares(self, weights: Tensor, sizes: Sizes) -> Tensor:
        """(g,) weighted sums of squared errors."""
        return ((self.errors(weights, sizes) ** 2).sum(1) * self.weight).sum(1)

    def through(self, y: Tensor) -> Tensor:
        return self.offset + (y if self.gain is None else (self.gain * y[:, None]).sum(2))


def _poses_last(array: np.ndarray) -> Tensor:
    return _tensor(np.moveaxis(array, 1, -1))


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float64))


def forward(weights: Tensor, sizes: Sizes, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Both hidden layers (g, H, n) and the outputs (g, n_out, n) at x: (g, n_in, n)."""
    w1, b1, w2, b2, w3, b3 = split(weights, sizes)
    first = torch.baddbmm(b1[..., None], w1, x).tanh_()
    second = torch.baddbmm(b2[..., None], w2, first).tanh_()
    return first, second, torch.baddbmm(b3[..., None], w3, second)


class System(Protocol):
    """One member, linearised."""

    def step(self, damping: float, pull: float, away: Tensor) -> Tensor | None:
        """(n_weights,) that least squares, damping and pull ask for; None where that is no number.

        away: (n_weights,) from where the pull draws to; damping: of the diagonal's mean.
        """
        ...


def linearised(weights: Tensor, sizes: Sizes, rows: Rows) -> list[System]:
    """Each of the g members at its weights (g, n_weights)."""
    n, n_weights = rows.weight.shape[1], weights.shape[1]
    # measured, 3-16-16-3 with 30, 150, 306, 360 rows: 0.25, 0.32, 0.61 and 0.71 of the primal's time
    if n * rows.offset.shape[1] < n_weights:
        members, each = Dual.of, 1
    else:
        members, each = Primal.of, max(1, _CHUNK // n)
    systems: list[System] = []
    for first in range(0, len(weights), each):
        some = slice(first, first + each)
        systems += members(weights[some], sizes, rows[some])
    return systems


def _solved(matrix: Tensor, lift: float, right: Tensor) -> Tensor | None:
    """(matrix + lift)^-1 right, or None where that is not positive definite.

    LAPACK by scipy: torch 2.13 takes as long again to clear the triangle that nobody reads, and twice that in batches.
    """
    lifted = matrix.numpy().copy()
    lifted.reshape(-1)[:: len(lifted) + 1] += lift
    _, solution, info = _posv(lifted.T, right.numpy(), lower=True, overwrite_a=True)
    return None if info else torch.from_numpy(solution)


@dataclass(frozen=True)
class Primal:
    gradient: Tensor  # (n_weights,) J^T W e
    normal: Tensor  # (n_weights, n_weights) J^T W J

    @staticmethod
    def of(weights: Tensor, sizes: Sizes, rows: Rows) -> list[Primal]:
        places, n = _places(sizes), rows.weight.shape[1]
        blocks = [_sums(weights, sizes, rows.poses(slice(k, k + _CHUNK))) for k in range(0, n, _CHUNK)]
        gradient, numbers = (
            torch.stack(parts).sum(0) if n > _CHUNK else parts[0] for parts in zip(*blocks, strict=True)
        )
        return [
            Primal(g, own.index_select(0, places.reshape(-1)).view(places.shape))
            for g, own in zip(gradient, numbers, strict=True)
        ]

    def step(self, damping: float, pull: float, away: Tensor) -> Tensor | None:
        lift = damping * (float(self.normal.diagonal().mean()) + pull) + pull
        return _solved(self.normal, lift, self.gradient + pull * away)


def _sums(weights: Tensor, sizes: Sizes, rows: Rows) -> tuple[Tensor, Tensor]:
    """The gradient, and all different numbers of J^T W J in the order of `_places`."""
    _, _, w2, _, w3, _ = split(weights, sizes)
    first, second, y = forward(weights, sizes, rows.x)
    slope1, slope2 = 1 - first**2, 1 - second**2
    inputs = [_with_one(z) for z in (rows.x, first, second)]
    gradient = _gradient(rows.through(y), rows, (w2, w3), (slope1, slope2), inputs)
    if rows.gain is None:
        c33 = torch.eye(sizes[-1], dtype=weights.dtype)[..., None] * rows.weight[:, None, None]
    else:
        c33 = ((rows.gain * rows.weight[:, None, None])[:, :, :, None] * rows.gain[:, :, None]).sum(1)
    # c[l, k]: (t_l^T t_k) of two layers, (g, units, units, n)
    c32 = (w3.mT[:, None] @ c33) * slope2[:, None]
    c31 = (w2.mT[:, None] @ c32) * slope1[:, None]
    c22 = _left(w3.mT, c32) * slope2[:, :, None]
    c21 = (w2.mT[:, None] @ c22) * slope1[:, None]
    c11 = _left(w2.mT, c21) * slope1[:, :, None]
    z1, z2, z3 = inputs
    sums = [
        _half(c11) @ _half_product(z1).mT,
        c21.flatten(1, 2) @ _product(z2, z1).mT,
        _half(c22) @ _half_product(z2).mT,
        c31.flatten(1, 2) @ _product(z3, z1).mT,
        c32.flatten(1, 2) @ _product(z3, z2).mT,
        _half(c33) @ _half_product(z3).mT,
    ]
    return gradient, torch.cat([s.flatten(1) for s in sums], dim=1)


def descent(weights: Tensor, sizes: Sizes, rows: Rows) -> tuple[Tensor, Tensor]:
    """The weighted sum of squared errors (g,), and J^T W e (g, n_weights), half its gradient."""
    _, _, w2, _, w3, _ = split(weights, sizes)
    first, second, y = forward(weights, sizes, rows.x)
    error, inputs = rows.through(y), [_with_one(z) for z in (rows.x, first, second)]
    gradient = _gradient(error, rows, (w2, w3), (1 - first**2, 1 - second**2), inputs)
    return ((error**2).sum(1) * rows.weight).sum(1), gradient


def _gradient(error: Tensor, rows: Rows, late: Sequence[Tensor], slopes: Sequence[Tensor], inputs: Sequence[Tensor]):
    """J^T W e by backpropagation through the weights of the later layers."""
    weighted = error * rows.weight[:, None]
    delta3 = weighted if rows.gain is None else (rows.gain * weighted[:, :, None]).sum(1)
    delta2 = (late[1].mT @ delta3) * slopes[1]
    delta1 = (late[0].mT @ delta2) * slopes[0]
    return _flat([delta @ z.mT for delta, z in zip((delta1, delta2, delta3), inputs, strict=True)])


def _left(w: Tensor, c: Tensor) -> Tensor:
    """w (g, i, j) times c (g, j, k, n) over j."""
    return (w @ c.flatten(2)).unflatten(2, c.shape[2:])


def _with_one(z: Tensor) -> Tensor:
    return torch.cat([z, torch.ones_like(z[:, :1])], dim=1)


def _product(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, None] * b[:, None]).flatten(1, 2)


def _half(c: Tensor) -> Tensor:
    """(g, k (k + 1) / 2, n) of symmetric c: (g, k, k, n)."""
    i, j = _pairs(c.shape[1])
    return c.flatten(1, 2).index_select(1, i * c.shape[1] + j)


def _half_product(z: Tensor) -> Tensor:
    i, j = _pairs(z.shape[1])
    return z.index_select(1, i) * z.index_select(1, j)


@lru_cache(maxsize=16)
def _pairs(k: int) -> tuple[Tensor, Tensor]:
    """The rows and columns of a triangle of k rows."""
    i, j = (torch.from_numpy(v) for v in np.triu_indices(k))
    return i, j


def _flat(matrices: Sequence[Tensor]) -> Tensor:
    """Flat weights (g, n_weights) of each layer's (g, units, inputs + 1), the bias last."""
    return torch.cat([part for m in matrices for part in (m[..., :-1].flatten(1), m[..., -1])], dim=1)


@lru_cache(maxsize=8)
def _places(sizes: Sizes) -> Tensor:
    """(n_weights, n_weights) where each entry of J^T J stands among the numbers of `_sums`."""
    n_in, n_out = sizes[:-1], sizes[1:]
    unit = [np.concatenate([np.repeat(np.arange(k), n), np.arange(k)]) for n, k in zip(n_in, n_out, strict=True)]
    seen = [np.concatenate([np.tile(np.arange(n), k), np.full(k, n)]) for n, k in zip(n_in, n_out, strict=True)]
    first = np.cumsum([0, *(len(u) for u in unit)])
    places = np.empty((first[-1], first[-1]), dtype=np.int64)
    start = 0
    for late in range(3):
        for early in range(late + 1):
            width, other = n_in[late] + 1, n_in[early] + 1
            pairs = np.arange(n_out[late] * n_out[early]).reshape(n_out[late], n_out[early])
            inputs = np.arange(width * other).reshape(width, other)
            if late == early:
                pairs, inputs = _symmetric(n_out[late]), _symmetric(width)
            n_inputs = int(inputs.max()) + 1
            block = start + pairs[np.ix_(unit[late], unit[early])] * n_inputs + inputs[np.ix_(seen[late], seen[early])]
            here, there = slice(first[late], first[late + 1]), slice(first[early], first[early + 1])
            places[here, there], places[there, here] = block, block.T
            start += (int(pairs.max()) + 1) * n_inputs
    return torch.from_numpy(places)


def _symmetric(k: int) -> np.ndarray:
    """(k, k) the number of each pair in `np.triu_indices`."""
    places = np.zeros((k, k), dtype=np.int64)
    i, j = np.triu_indices(k)
    places[i, j] = places[j, i] = np.arange(len(i))
    return places


@dataclass(frozen=True)
class Dual:
    """By (J J^T + l)^-1, for fewer rows than weights: J^T (J J^T + l)^-1 = (J^T J + l)^-1 J^T."""

    kernel: Tensor  # (m n, m n): J J^T, rows weighted by their roots
    error: Tensor  # (m n,), weighted
    reaching: tuple[Tensor, ...]  # of each layer (m, n, units): t, weighted
    seen: tuple[Tensor, ...]  # (n, inputs + 1): z

    @staticmethod
    def of(weights: Tensor, sizes: Sizes, rows: Rows) -> list[Dual]:
        _, _, w2, _, w3, _ = split(weights, sizes)
        first, second, y = forward(weights, sizes, rows.x)
        root = rows.weight.sqrt()
        m, n = rows.offset.shape[1:]
        gain = torch.eye(m, dtype=weights.dtype)[:, None] if rows.gain is None else rows.gain.mT
        t3 = gain * root[:, None, :, None]
        t2 = (t3 @ w3[:, None]) * (1 - second**2).mT[:, None]
        t1 = (t2 @ w2[:, None]) * (1 - first**2).mT[:, None]
        reaching, seen = (t1, t2, t3), tuple(_with_one(z).mT for z in (rows.x, first, second))
        error = (rows.through(y) * root[:, None]).flatten(1)
        kernel = weights.new_zeros(len(weights), m, n, m, n)
        for t, z in zip(reaching, seen, strict=True):
            t = t.flatten(1, 2)
            kernel.addcmul_((t @ t.mT).view_as(kernel), (z @ z.mT)[:, None, :, None])
        kernel = kernel.view(len(weights), m * n, m * n)
        return [
            Dual(kernel[k], error[k], tuple(t[k] for t in reaching), tuple(z[k] for z in seen))
            for k in range(len(weights))
        ]

    def step(self, damping: float, pull: float, away: Tensor) -> Tensor | None:
        # s = J^T u + share * away solves (J^T J + lift) s = J^T e + pull * away
        lift = damping * (float(self.kernel.diagonal().sum()) / len(away) + pull) + pull
        share = pull / lift if pull else 0.0
        solved = _solved(self.kernel, lift, self.error - share * self.times(away) if pull else self.error)
        return None if solved is None else self.transposed_times(solved) + share * away

    def times(self, direction: Tensor) -> Tensor:
        """J v (m n,) of v: (n_weights,)."""
        first, second, last = (t.shape[-1] for t in self.reaching)
        parts = split(direction, (self.seen[0].shape[-1] - 1, first, second, last))
        moved = torch.zeros(self.reaching[0].shape[:2], dtype=direction.dtype)
        for t, z, w, b in zip(self.reaching, self.seen, parts[::2], parts[1::2], strict=True):
            moved += (t * (z[:, :-1] @ w.mT + b)).sum(-1)
        return moved.flatten()

    def transposed_times(self, u: Tensor) -> Tensor:
        """J^T u (n_weights,) of u: (m n,)."""
        of_rows = u.view(*self.reaching[0].shape[:2], 1)
        return _flat([((t * of_rows).sum(0).mT @ z)[None] for t, z in zip(self.reaching, self.seen, strict=True)])[0]
