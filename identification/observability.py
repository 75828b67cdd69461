"""Observability indexes O1 .. O5 of a set of poses (Sun & Hollerbach 2008, IEEE ICRA, 831-837): larger is better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.error_model import Parameters
from kincal.identification.identifiability import FLAT_SCALE

_NULL = 1e-12  # relative to the largest singular value: smaller ones are rounding


@dataclass(frozen=True)
class Observability:
    """From the singular values s1 >= .. >= sL of the whitened Jacobian, every parameter measured in its tolerance.

    L is the number of directions that this robot's poses can excite. The indexes are 0, and the condition number
    infinite, where the poses at hand excite fewer.
    """

    excited: int  # directions
    excitable: int  # L
    o1: float  # (s1 .. sL)^(1/L) / sqrt(n): D-optimal (Borm & Menq 1991)
    o2: float  # sL / s1 (Driels & Pathre 1990)
    o3: float  # sL: E-optimal (Nahvi et al. 1994)
    o4: float  # sL^2 / s1 (Nahvi & Hollerbach 1996)
    o5: float  # 1 / (1/s1 + .. + 1/sL): A-optimal (Sun & Hollerbach 2008)

    @property
    def condition_number(self) -> float:
        return 1 / self.o2 if self.o2 > 0 else float("inf")


def observability(jacobian: np.ndarray, parameters: Parameters, rank: int) -> Observability:
    """jacobian: (n, rows a pose, n_parameters), whitened; rank: L, of all that this robot's poses can show."""
    scale = np.where(parameters.flat, FLAT_SCALE, parameters.tolerance)
    singular = np.linalg.svd(jacobian.reshape(-1, len(parameters)) * scale, compute_uv=False)
    return indexes(np.concatenate([singular, np.zeros(rank)])[:rank], len(jacobian))


def indexes(singular: np.ndarray, n: int) -> Observability:
    """singular: (L,) descending, of n poses."""
    first, last = float(singular[0]), float(singular[-1])
    excited = int(np.sum(singular > _NULL * first))
    if excited < len(singular):
        return Observability(excited, len(singular), 0.0, 0.0, 0.0, 0.0, 0.0)
    return Observability(
        excited,
        len(singular),
        o1=float(np.exp(np.mean(np.log(singular))) / np.sqrt(n)),
        o2=last / first,
        o3=last,
        o4=last**2 / first,
        o5=float(1 / np.sum(1 / singular)),
    )
