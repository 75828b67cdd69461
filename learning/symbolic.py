"""The residual network as CasADi expressions: what `Correction` is in numpy, for generated code."""

from __future__ import annotations

import casadi as ca

from kincal.learning.correction import MARGIN, Correction


def delta(correction: Correction, x: ca.SX) -> ca.SX:
    """(k,): `correction(x)` at x: (k,)."""
    units = correction.units
    weights, names = correction.scale[units.layout[0]] * correction.readout, units.layout[1]
    u, total = (x - units.centre) / units.span, ca.SX.zeros(units.n_joints)
    for group in units.groups:
        total += group.outputs(u, x, weights[[name == group.name for name in names]])
    return total


def share(correction: Correction, x: ca.SX) -> ca.SX:
    """`correction.share(x)` at x: (k,)."""
    u = (x - correction.units.centre) / correction.units.span
    outside = ca.fmax(ca.mmax(correction.hull.directions @ u - correction.hull.reach), 0.0)
    distance = ca.fmin(outside / (2 * MARGIN), 1.0)
    return ca.SX(correction.shrinkage * (1 - distance**2) ** 2)
