"""Singular value decomposition that does not give up."""

from __future__ import annotations

import numpy as np


def svd(matrix: np.ndarray, full_matrices: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u, singular values, vt: numpy's, and where its fast driver fails, LAPACK's slow and sure one.

    gesdd gives up on some finite matrices (seen on one of 181 x 168 with entries down to 1e-50); gesvd does not.
    Raises numpy.linalg.LinAlgError for matrices that are not finite.
    """
    try:
        return np.linalg.svd(matrix, full_matrices=full_matrices)
    except np.linalg.LinAlgError:
        import scipy.linalg

        if not np.isfinite(matrix).all():
            raise
        return scipy.linalg.svd(matrix, full_matrices=full_matrices, lapack_driver="gesvd")
