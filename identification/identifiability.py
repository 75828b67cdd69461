"""What the measurements can see: rank, singular values, unobservable directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from kincal.identification.error_model import Parameters
from kincal.identification.identification import HUMAN
from kincal.identification.singular_values import svd

_NULL = 1e-10  # relative to the largest singular value: no exactly null one is larger, by rounding alone
_GAP = 100.0  # a narrower one decides nothing
FLAT_SCALE = 1e-3  # W and T have no tolerance: one millimetre, one milliradian
_SHARE = 1e-6
_TERMS = 5  # of a direction, written out


@dataclass(frozen=True)
class Identifiability:
    """Of the whitened identification Jacobian, every parameter measured in its tolerance; priors play no part."""

    rank: int
    singular_values: np.ndarray  # (n_parameters,), descending
    tolerance: float  # below it a singular value counts as zero
    gap: float  # the last singular value above the tolerance over the first below; infinite where none is below
    condition_number: float  # of the identifiable subspace
    observable_share: np.ndarray  # (n_parameters,) squared length of each parameter's projection on it, 0 .. 1
    unobservable: tuple[str, ...]  # a sparse basis of the rest, in parameter names
    basis: np.ndarray  # (n_parameters - rank, n_parameters) of the same, orthonormal, parameters in their tolerances

    @property
    def identifiable(self) -> np.ndarray:
        """(n_parameters,) bool: the data alone determine the parameter, whatever the others are."""
        return self.observable_share > 1 - _SHARE


def identifiability(jacobian: np.ndarray, parameters: Parameters, rows: int | None = None) -> Identifiability:
    """jacobian: (rows, n_parameters) of the whitened residuals, at the geometry as drawn; or its triangle, of `rows`.

    There the gap between what is seen and what is not is wide. Where every axis is a little off, as built, effects of
    second order close it: singular values that are not zero, and far too small for any measurement to tell.
    """
    n = len(parameters)
    scale = np.where(parameters.flat, FLAT_SCALE, parameters.tolerance)
    _, singular, vt = svd(np.asarray(np.linalg.qr(jacobian * scale, mode="r")), full_matrices=True)
    singular = np.concatenate([singular, np.zeros(n - len(singular))])
    tolerance = rank_tolerance(singular, rows or len(jacobian))
    rank = int(np.sum(singular > tolerance))
    share = np.sum(vt[:rank] ** 2, axis=0)
    condition = float(singular[0] / singular[rank - 1]) if rank else float("inf")
    null = float(singular[rank]) if rank < n else 0.0
    gap = float(singular[rank - 1]) / null if rank and null > 0 else float("inf")
    unobservable = _in_names(vt[rank:].T, scale, parameters)
    return Identifiability(rank, singular, tolerance, gap, condition, share, unobservable, vt[rank:])


def rank_tolerance(singular: np.ndarray, rows: int) -> float:
    """In the widest gap (on a log scale) above a singular value that may be null: exact derivatives make it wide.

    Where no gap stands out, rounding decides, as in numpy's matrix_rank.
    """
    floor = max(rows, len(singular)) * np.finfo(float).eps * float(singular[0])
    values = np.maximum(singular, floor)
    gaps = np.where(values[1:] < _NULL * singular[0], values[:-1] / values[1:], 0.0)
    widest = int(np.argmax(gaps)) if len(gaps) else 0
    if not len(gaps) or gaps[widest] < _GAP:
        return floor
    return float(np.sqrt(values[widest] * values[widest + 1]))


def _in_names(null_space: np.ndarray, scale: np.ndarray, parameters: Parameters) -> tuple[str, ...]:
    """A sparse basis of the null space (n_parameters, k), each vector led by the parameter that it alone holds."""
    k = null_space.shape[1]
    if not k:
        return ()
    pivots = scipy.linalg.qr(null_space.T, pivoting=True, mode="r")[1][:k]  # pyright: ignore[reportGeneralTypeIssues]
    basis = null_space @ np.linalg.inv(null_space[pivots])  # 1 at its own pivot, 0 at the others'
    physical = basis * scale[:, None] / scale[pivots]
    return tuple(_written(physical[:, i], basis[:, i], pivots[i], parameters) for i in range(k))


def _written(direction: np.ndarray, scaled: np.ndarray, pivot: int, parameters: Parameters) -> str:
    """x trades against y and z, 1 mm : -0.5 mm : 0.02 deg; in short 1:1 where that is all."""
    others = [j for j in np.argsort(-np.abs(scaled)) if j != pivot and abs(scaled[j]) > 1e-6]
    name, (unit, factor) = parameters.names[pivot], HUMAN[parameters.units[pivot]]
    if not others:
        return f"{name} has no effect on the measurements"
    shown, ratio = others[:_TERMS], [f"1 {unit}"]
    for j in shown:
        other, times = HUMAN[parameters.units[j]]
        ratio.append(f"{direction[j] * times / factor:.3g} {other}")
    if len(others) == 1 and ratio[1] in (f"1 {unit}", f"-1 {unit}"):
        return f"{name} trades against {parameters.names[shown[0]]} 1:{ratio[1].split()[0]}"
    names = [parameters.names[j] for j in shown]
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    more = f" (and {len(others) - _TERMS} by less)" if len(others) > _TERMS else ""
    return f"{name} trades against {listed}{more}, {' : '.join(ratio)}"
