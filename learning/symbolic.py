"""The residual network as CasADi expressions: what `Correction` is in numpy, for generated code."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from kincal.learning.correction import MARGIN, Correction
from kincal.learning.network import Network, split
from kincal.learning.units import INHERITED, OWN, SHARED, WAVES, own_centres

_FAR = 3.0  # in ranges: beyond, nothing is believed, and exponentials would overflow


def delta(correction: Correction, x: ca.SX) -> ca.SX:
    """(k,): `correction(x)` at x: (k,)."""
    units, k = correction.units, correction.units.n_joints
    joints, names = units.layout
    weights = correction.scale[joints] * correction.readout

    def of(group: str) -> np.ndarray:
        return weights[np.array([name == group for name in names], dtype=bool)]

    u, total = (x - units.centre) / units.span, ca.SX.zeros(k)
    if units.own:
        for j, row in enumerate(of(OWN).reshape(k, -1)):
            total[j] += _radial(row, u[j])
    for (j, cycles), (sine, cosine) in zip(units.waves, of(WAVES).reshape(-1, 2), strict=True):
        phase = np.pi * cycles * (u[int(j)] + 1)
        total[int(j)] += sine * ca.sin(phase) + cosine * ca.cos(phase)
    if len(units.shared):
        total += of(SHARED).reshape(k, -1) @ _tanh(units.shared[:, :-1] @ u + units.shared[:, -1])
    if units.inherited is not None:
        by_shape = of(INHERITED).reshape(k, -1) * units.inherited.spread.T
        total += _shapes(units.inherited.network, x, by_shape)
    return total


def share(correction: Correction, x: ca.SX) -> ca.SX:
    """`correction.share(x)` at x: (k,)."""
    u = (x - correction.units.centre) / correction.units.span
    outside = ca.fmax(ca.mmax(correction.hull.directions @ u - correction.hull.reach), 0.0)
    distance = ca.fmin(outside / (2 * MARGIN), 1.0)
    return ca.SX(correction.shrinkage * (1 - distance**2) ** 2)


def _radial(weights: np.ndarray, u: ca.SX) -> ca.SX:
    """The sum of one joint's radial units. Their centres are evenly spaced: each is a power of one exponential.

    exp(-(u - c_i)^2 / 2 w^2) = exp(-(u^2 - c_0^2) / 2 w^2 + ..) g^i with g = exp(u h / w^2), c_i = c_0 + i h.
    """
    centres, width = own_centres(len(weights))
    u = ca.fmin(ca.fmax(u, -_FAR), _FAR) / width
    first, space = centres[0] / width, (centres[-1] - centres[0]) / max(len(centres) - 1, 1) / width
    powers, total = ca.exp(u * space), ca.SX(0)
    for i, weight in reversed(list(enumerate(weights))):
        total = total * powers + weight * np.exp(-0.5 * (i * space) ** 2 - i * first * space)
    return total * ca.exp(-0.5 * (u - first) ** 2)


def _shapes(network: Network, x: ca.SX, readout: np.ndarray) -> ca.SX:
    """readout (k, n_out) @ network(x), with the readout multiplied into the last layer."""
    w1, b1, w2, b2, w3, b3 = split(network.weights, network.sizes)
    last = readout * network.output_scale
    first = _tanh((w1 / network.input_scale) @ x + (b1 - (w1 / network.input_scale) @ network.input_centre))
    return (last @ w3) @ _tanh(w2 @ first + b2) + last @ b3


def _tanh(x: Any) -> Any:
    """By exp, which takes half as long as tanh; to an absolute 1e-16."""
    return 1 - 2 / (1 + ca.exp(2 * x))
