"""Actuators: joint value = zero + gain * reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Actuator


@dataclass(frozen=True)
class Actuators:
    """Gains and zeros: (n_actuated,), in the chain's order. Readings have the encoders' own units."""

    gain: np.ndarray  # [rad or m per unit of the reading]
    zero: np.ndarray  # [rad or m]

    @staticmethod
    def nominal(chain: ClosedChain, settings: Mapping[str, Actuator]) -> Actuators:
        """As robot.toml has them; where it says nothing a reading is the joint value."""
        chosen = [settings.get(name, Actuator()) for name in chain.actuated_names]
        return Actuators(np.array([a.gain for a in chosen]), np.array([a.zero for a in chosen]))

    def joints(self, readings: np.ndarray) -> np.ndarray:
        """Actuated joint values (n, n_actuated) [rad or m] of readings (n, n_actuated)."""
        return self.zero + self.gain * readings

    def readings(self, joints: np.ndarray) -> np.ndarray:
        """The inverse of `joints`."""
        return (joints - self.zero) / self.gain
