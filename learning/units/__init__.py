"""The residual network's hidden units, in groups of one kind each; what it puts out is linear in them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from kincal.learning.units.inherited import Inherited
from kincal.learning.units.own import Own
from kincal.learning.units.shared import Shared
from kincal.learning.units.waves import Waves

AnyGroup = Own | Waves | Shared | Inherited
GROUPS: tuple[type[AnyGroup], ...] = get_args(AnyGroup)  # in the order of their weights
STRUCTURES: dict[str, tuple[type[AnyGroup], ...]] = {  # simple ones first: of equals the first is taken
    "each joint its own": (Own,),
    "periodic": (Waves,),
    "all to all": (Shared,),
    "inherited": (Inherited,),
    "periodic, inherited": (Waves, Inherited),
    "each joint its own, inherited": (Own, Inherited),
    "each joint its own, periodic, inherited": (Own, Waves, Inherited),
    "each joint its own, all to all": (Own, Shared),
    "all": (Own, Waves, Shared, Inherited),
}


@dataclass(frozen=True)
class Units:
    """Of readings x (n, k), which are scaled to -1 .. 1 by centre and span."""

    centre: np.ndarray  # (k,)
    span: np.ndarray  # (k,)
    groups: tuple[AnyGroup, ...]  # in the order of GROUPS

    @property
    def n_joints(self) -> int:
        return len(self.centre)

    @property
    def layout(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """The joint that each weight moves, (n_weights,), and its group's name."""
        joints = [group.joints(self.n_joints) for group in self.groups]
        names = [name for group, own in zip(self.groups, joints, strict=True) for name in [group.name] * len(own)]
        return np.concatenate([np.zeros(0, dtype=int), *joints]), tuple(names)

    def scaled(self, x: np.ndarray) -> np.ndarray:
        return (x - self.centre) / self.span

    def values(self, x: np.ndarray) -> np.ndarray:
        """(n, n_weights): every weight's unit at x: (n, k)."""
        u = self.scaled(x)
        return np.concatenate([np.zeros((len(x), 0)), *(group.values(u, x) for group in self.groups)], axis=1)

    def only(self, kinds: Iterable[type[AnyGroup]]) -> Units:
        """Without the groups of other kinds."""
        return replace(self, groups=tuple(g for g in self.groups if isinstance(g, tuple(kinds))))


def range_of(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half the range of inputs (n, k); an input that never moves has a range of one."""
    low, high = x.min(axis=0), x.max(axis=0)
    half = (high - low) / 2
    return (low + high) / 2, np.where(half > 1e-12, half, 1.0)
