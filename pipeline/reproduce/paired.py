"""Two methods on the same robots: ratios of their errors, one a seed, and whether they could be chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np

SIGNIFICANT = 0.05
_MOST_EXACT = 7  # sizes whose orders are all tried


@dataclass(frozen=True)
class Paired:
    """Errors of a first method over those of a second one: above 1 the second is better."""

    seeds: int
    ratio: float  # median
    low: float  # quartiles
    high: float
    second_better: int  # seeds
    p: float  # Wilcoxon's signed-rank test of the logarithms, two-sided

    @property
    def says(self) -> int:
        """1: the second is better; -1: the first is; 0: no difference is shown."""
        return 0 if self.p >= SIGNIFICANT else 1 if self.ratio > 1 else -1


def paired(first: np.ndarray, second: np.ndarray) -> Paired:
    """first, second: (seeds,) errors of two methods on the same seeds."""
    logarithm = np.log(np.asarray(first, dtype=float) / np.asarray(second, dtype=float))
    low, ratio, high = np.exp(np.quantile(logarithm, (0.25, 0.5, 0.75)))
    better = int(np.count_nonzero(logarithm > 0))
    return Paired(len(logarithm), float(ratio), float(low), float(high), better, signed_rank(logarithm))


def signed_rank(values: np.ndarray) -> float:
    """The p of Wilcoxon's signed-rank test that values (n,) lie about 0; zeros say nothing either way."""
    from scipy.stats import wilcoxon

    values = values[values != 0]
    if not len(values):
        return 1.0
    return float(np.array(wilcoxon(values, method="exact" if len(values) <= 50 else "approx"))[1])


def holm(p: Sequence[float]) -> list[float]:
    """Each p adjusted for how many were looked at (Holm 1979)."""
    order, adjusted, largest = np.argsort(p, kind="stable"), [0.0] * len(p), 0.0
    for k, place in enumerate(order):
        largest = max(largest, min(1.0, (len(p) - k) * p[place]))
        adjusted[place] = largest
    return adjusted


@dataclass(frozen=True)
class Trend:
    """How a ratio moves with n."""

    rho: float  # Spearman's, of its median over seeds
    p: float
    rho_by_seed: float  # the median over seeds of each seed's own
    p_by_seed: float  # of these, by the signed-rank test: the sizes of one seed share a robot, seeds share nothing


def trend(n: np.ndarray, ratios: np.ndarray) -> Trend | None:
    """n: (k,) sizes; ratios: (seeds, k). None for fewer than three sizes, or where nothing moves."""
    from scipy.stats import spearmanr

    logarithm = np.log(ratios)
    rows = [row for row in (np.median(logarithm, axis=0), *logarithm) if len(n) > 2 and len(set(row.tolist())) > 1]
    if len(rows) <= len(ratios):
        return None
    (rho, p), *each = (np.array(spearmanr(n, row)) for row in rows)
    if len(n) <= _MOST_EXACT:
        p = _exact_p(n, rows[0])
    correlations = np.array([rho for rho, _ in each])
    return Trend(float(rho), float(p), float(np.median(correlations)), signed_rank(correlations))


def _exact_p(n: np.ndarray, row: np.ndarray) -> float:
    """Of Spearman's rho, over all orders: scipy's own p is for many sizes, and 0 where all of a few are in order."""
    from scipy.stats import permutation_test, rankdata

    of_n = rankdata(n) - rankdata(n).mean()
    test = permutation_test(
        (rankdata(row),),
        lambda ranks, axis: ranks @ of_n,
        permutation_type="pairings",
        n_resamples=factorial(_MOST_EXACT),  # all, if these are enough
        vectorized=True,
    )
    return float(test.pvalue)
