"""What a kind of hidden units of the residual network is: one file, and its line in `GROUPS`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True)
class Evidence:
    """Measured poses (n) of m whitened rows each, which decide what units there are, and the settings of a robot."""

    u: np.ndarray  # (n, k) readings, scaled to -1 .. 1
    error: np.ndarray  # (n, m)
    explained: np.ndarray  # (n, m, K) d error / d what explains it already, in its priors' sigmas
    by_output: np.ndarray  # (n, m, k) d error / d output, in units of the outputs' size
    inherited: Group | None  # of virtual siblings
    own: int  # radial units of each joint
    shared: int  # tanh units of all joints
    seed: int


class Group(ABC):
    """Hidden units of one kind. The correction is linear in their weights."""

    name: ClassVar[str]

    @classmethod
    @abstractmethod
    def of(cls, evidence: Evidence) -> Self | None:
        """The units for a robot; None: none."""

    @abstractmethod
    def joints(self, n_joints: int) -> np.ndarray:
        """(n_weights,): the joint that each weight moves."""

    @abstractmethod
    def values(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(n, n_weights): every weight's unit at readings x (n, k), which u (n, k) are scaled."""

    @abstractmethod
    def outputs(self, u: ca.SX, x: ca.SX, weights: np.ndarray) -> ca.SX:
        """(k,): what they put out at one pose, as a CasADi expression, with the weights (n_weights,)."""
