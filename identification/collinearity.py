"""Belsley's collinearity diagnostics and variance inflation factors of the identification Jacobian."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from kincal.identification.error_model import Parameters
from kincal.identification.identification import Collinearity
from kincal.identification.shrinkage import N_FRAMES, Linear, identifiable, without_frames
from kincal.identification.singular_values import svd


def collinearity(triangle: np.ndarray, rows: int, parameters: Parameters) -> Collinearity:
    """triangle: of the whitened identification Jacobian and any last column (m, n_parameters + 1), of `rows` rows.

    Of the parameters the largest set that the data tell apart is taken, by QR with pivoting in tolerance units.
    """
    n = len(parameters) - N_FRAMES
    scale = parameters.tolerance[:n]
    rank = len(identifiable(Linear(triangle, rows), scale))
    geometry = without_frames(triangle)[:, :n] * scale
    if not rank:
        return Collinearity((), np.zeros(0), np.zeros(0), np.zeros((0, 0)))
    pivots = scipy.linalg.qr(geometry, mode="r", pivoting=True)[1][:rank]  # pyright: ignore[reportGeneralTypeIssues]
    columns = geometry[:, pivots] / np.linalg.norm(geometry[:, pivots], axis=0)
    _, singular, vt = svd(columns)
    variance = (vt.T / singular) ** 2  # (parameter, singular direction)
    inflation = variance.sum(axis=1)
    return Collinearity(
        tuple(parameters.names[j] for j in pivots),
        inflation,
        singular[0] / singular,
        (variance / inflation[:, None]).T,
    )
