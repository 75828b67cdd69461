"""Which unit of a fleet is out of family: one whose identified changes are not like those of its sisters.

In tolerances z = change / tolerance, a unit drawn from its tolerances has MAP estimates z ~ N(0, 1 - C), with C their
posterior covariance (law of total variance). The eigenvectors of 1 - C whose eigenvalue is above one half are what the
data say more of than the prior: the identifiable subspace, in which coordinates scaled by the root of the eigenvalue
are N(0, 1). The fleet's own medians are their centre, so that what all units share (sag under one payload) is no
deviation; what one sigma is, the fleet's own spread says: one for all coordinates from the median distance, and for
each the larger of that and its median absolute deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from kincal.identification.identification import Identification

FEWEST = 5  # units, for a family
FALSE_ALARM = 0.01  # of all fleets without such a unit, those in which one is named

_MAD = 1.4826  # of a normal distribution: sigma over the median absolute deviation
_EFFICIENCY = 0.6  # of a median beside a mean: by so much fewer readings do sigmas rest on


@dataclass(frozen=True)
class Membership:
    """How one unit stands to its family."""

    spread: float  # root mean square of its changes in the identifiable subspace, as tolerances and sensors let expect
    distance: float | None  # the same from the family's centre, in the family's own sigmas; None without a family
    probability: float | None  # of a unit this far in a fleet of this size, were all alike
    parameter: str | None  # the one that is furthest off
    deviation: float | None  # of that one, in the family's sigmas

    @property
    def out_of_family(self) -> bool | None:
        return None if self.probability is None else self.probability < FALSE_ALARM


def memberships(units: Sequence[Identification]) -> list[Membership]:
    """Of units of one design: the same parameters and tolerances."""
    free = np.isfinite(units[0].tolerance)
    names = np.array(units[0].names)[free]
    scale = units[0].tolerance[free]
    z = np.array([unit.change[free] for unit in units]) / scale
    c = np.mean([unit.covariance[np.ix_(free, free)] for unit in units], axis=0) / np.outer(scale, scale)
    known, basis = np.linalg.eigh(np.eye(len(scale)) - c)
    seen = known > 0.5
    a = z @ (basis[:, seen] / np.sqrt(known[seen]))  # (n, r)
    spread = np.sqrt(np.mean(a**2, axis=1)) if seen.any() else np.zeros(len(units))
    if len(units) < FEWEST or not seen.any():
        return [Membership(float(s), None, None, None, None) for s in spread]
    sigma = 1 - np.diagonal(c)
    determined = sigma > 0.5  # parameters that the data tell by themselves
    return _judged(spread, a, z[:, determined] / np.sqrt(sigma[determined]), names[determined])


def _judged(spread: np.ndarray, a: np.ndarray, x: np.ndarray, names: np.ndarray) -> list[Membership]:
    """a (n, r): coordinates in the identifiable subspace; x (n, m): single parameters; both N(0, 1) by tolerance."""
    n, r = a.shape
    a, x = a - np.median(a, axis=0), x - np.median(x, axis=0)
    pooled = np.sqrt(np.median(np.sum(a**2, axis=1)) / (2 * special.gammaincinv(r / 2, 0.5)))
    if pooled == 0:  # most are copies of one unit: nothing tells how far apart sisters are
        return [Membership(float(s), None, None, None, None) for s in spread]
    squared = np.sum((a / _sigmas(a, pooled)) ** 2, axis=1)
    freedom = _EFFICIENCY * (n - 1) * r
    p = special.fdtrc(r, freedom, squared / r)
    t, which = np.zeros(n), np.zeros(n, dtype=int)
    if x.shape[1]:
        deviations = x / _sigmas(x, pooled)
        which = np.argmax(np.abs(deviations), axis=1)
        t = deviations[np.arange(n), which]
        p = np.minimum(p, 2 * x.shape[1] * special.stdtr(freedom, -np.abs(t)))
    p = np.minimum(1.0, 2 * n * p)  # Bonferroni: two questions of every unit
    return [
        Membership(
            float(spread[k]),
            float(np.sqrt(squared[k] / r)),
            float(p[k]),
            str(names[which[k]]) if x.shape[1] else None,
            float(t[k]) if x.shape[1] else None,
        )
        for k in range(n)
    ]


def _sigmas(centred: np.ndarray, pooled: float) -> np.ndarray:
    n = len(centred)
    return np.maximum(pooled, _MAD * n / (n - 0.8) * np.median(np.abs(centred), axis=0))
