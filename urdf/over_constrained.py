"""Loop equations that repeat one another: the mechanism closes as drawn; as built, of other parts, it would not."""

from __future__ import annotations

import numpy as np

from kincal.urdf.closed_chain import ClosedChain

# Of the loop equations' singular values, relative to the largest. Regular chains have 1e-2 and more (a millimetre-sized
# one 1e-5), over-constrained ones rounding: 1e-16 where drawn exactly, 1e-7 where coordinates have six decimals.
RANK_TOLERANCE = 1e-6


def dependent(jacobian: np.ndarray, tolerance: float = RANK_TOLERANCE) -> np.ndarray:
    """(n_dependent, n_equations): orthonormal combinations of the loop equations, of this Jacobian (n_equations,
    n_joints), that constrain nothing."""
    if not jacobian.size:
        return np.zeros((0, len(jacobian)))
    left, singular, _ = np.linalg.svd(jacobian)
    return left[:, np.count_nonzero(singular > tolerance * singular[0]) :].T


def what_to_do(chain: ClosedChain, void: np.ndarray) -> str:
    """The loops that take part in dependent combinations `void` (n_dependent, n_equations), and what helps."""
    share = np.sum(void**2, axis=0)  # of each equation: 0 independent, 1 void
    involved, row = [], 0
    for loop in chain.loops:
        parts = (("position", share[row : row + 3]), ("orientation", share[row + 3 : row + loop.rows]))
        kinds = [kind for kind, of_kind in parts if of_kind.sum() > 1e-3]
        if kinds:
            involved.append(f"{loop.name!r} ({' and '.join(kinds)})")
        row += loop.rows
    return (
        f"loops: they impose {chain.n_equations} equations, {chain.n_equations - len(void)} of them independent "
        f"at home: the mechanism is over-constrained (or singular there) by loop {', '.join(involved)}; parts that "
        "differ from the drawing could not close it. Use a point loop where the real joint is a ball, drop a loop that "
        f"repeats another, or add passive joints that take up the difference ({len(void)} in all)"
    )
