"""The residual network's expressions for generated code against what it is in numpy."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np
import pytest

from kincal.learning.correction import Correction, Hull, Spread
from kincal.learning.network import Network, count
from kincal.learning.symbolic import delta, share
from kincal.learning.units import Inherited, Own, Shared, Units, Waves
from kincal.learning.units.group import Evidence, Group

GROUPS = {
    "own": (6, 0, 0, False),
    "one radial unit": (1, 0, 0, False),
    "periodic": (0, 3, 0, False),
    "shared": (0, 0, 5, False),
    "inherited": (0, 0, 0, True),
    "all": (10, 2, 4, True),
    "nothing": (0, 0, 0, False),
}


def made(own: int, waves: int, shared: int, inherited: bool, k: int = 3) -> Correction:
    random = np.random.default_rng([own, waves, shared, inherited])
    x = random.uniform(-1, 1, (50, k)) * [0.1, 2.0, 30.0] + [0.5, -1.0, 7.0]
    centre, span = (x.max(axis=0) + x.min(axis=0)) / 2, (x.max(axis=0) - x.min(axis=0)) / 2
    sizes = (k, 7, 7, 5)
    network = Network(sizes, random.normal(size=count(sizes)), centre, span, random.uniform(0.5, 2, 5))
    periodic = np.column_stack([random.integers(0, k, waves), random.uniform(0.6, 20, waves)])
    groups = [Own(own)] * (own > 0) + [Waves(periodic)] * (waves > 0) + [Shared.random(k, shared, 0)] * (shared > 0)
    groups += [Inherited(network, random.uniform(0.1, 1, (5, k)))] * inherited
    units = Units(centre, span, tuple(groups))
    readout = random.normal(size=len(units.layout[0]))
    sure = Spread(np.zeros((0, 0)), np.zeros((0, 0)), 0.0, 1.0)
    return Correction(
        units, readout, np.array([1e-5, 1e-3, 0.1]), Hull.of(units.scaled(x)), "all", 0.9, 1.0, {}, sure, sure
    )


@pytest.mark.parametrize("groups", GROUPS)
def test_delta_and_share(groups):
    """Inside the training readings, where it fades, and far outside, where it must stay finite."""
    correction = made(*GROUPS[groups])
    random, units = np.random.default_rng(5), correction.units
    for reach in (1.0, 1.8, 100.0):
        x = units.centre + reach * units.span * random.uniform(-1, 1, (200, 3))
        symbol = ca.SX.sym("x", 3)
        shifts, shares = ca.Function("f", [symbol], [delta(correction, symbol), share(correction, symbol)])(x.T)
        np.testing.assert_allclose(shares.full()[0], correction.share(x), atol=1e-14)
        if reach < 2:
            np.testing.assert_allclose((shifts.full().T - correction(x)) / correction.scale, 0, atol=2e-13)
        assert np.isfinite(shifts.full()).all()


@dataclass(frozen=True)
class Backlash(Group):
    """A kind of unit that kincal does not have: where each joint comes from."""

    name: ClassVar[str] = "backlash"

    @classmethod
    def of(cls, evidence: Evidence) -> Self:
        return cls()

    def joints(self, n_joints: int) -> np.ndarray:
        return np.arange(n_joints)

    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.tanh(10 * u)

    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        return weights * ca.tanh(10 * u)


def test_a_new_kind_of_unit_is_one_class():
    """Values, weights, derivatives and generated code of a kind that nothing else knows, beside another kind."""
    known = made(10, 0, 0, False)
    units = replace(known.units, groups=(*known.units.groups, Backlash()))  # pyright: ignore[reportArgumentType]
    correction = replace(known, units=units, readout=np.append(known.readout, [0.5, -1.0, 2.0]))
    x = units.centre + units.span * np.random.default_rng(6).uniform(-1, 1, (50, 3))
    symbol = ca.SX.sym("x", 3)
    shifts = ca.Function("f", [symbol], [delta(correction, symbol)])(x.T).full().T
    np.testing.assert_allclose(shifts / correction.scale, correction(x) / correction.scale, atol=2e-13)
    added = correction(x) - known(x)
    expected = correction.scale * np.array([0.5, -1.0, 2.0]) * np.tanh(10 * units.scaled(x))
    np.testing.assert_allclose(added, expected, atol=1e-15)
