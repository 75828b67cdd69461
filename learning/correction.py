"""The residual network as a value: what it puts out, how far it is believed, and how sure its predictions are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kincal.learning.units import Units, Waves

HELD = 0.95  # of what is to come, within the regions that are told
MARGIN = 0.2  # of the training range: how far outside the hull the correction has faded to nothing


def variance(columns: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n, m, m): A C A' of columns (n, m, K)."""
    return (columns @ covariance) @ columns.swapaxes(1, 2)


@dataclass(frozen=True)
class Hull:
    """An outer polytope of points x (n, k): directions . x <= reach, over axes and their pairwise diagonals."""

    directions: np.ndarray  # (n_directions, k), in scaled inputs
    reach: np.ndarray  # (n_directions,)

    @staticmethod
    def of(x: np.ndarray) -> Hull:
        k = x.shape[1]
        eye = np.eye(k)
        diagonals = [(eye[i] + s * eye[j]) / np.sqrt(2) for i, j in combinations(range(k), 2) for s in (1, -1)]
        half = np.array([*eye, *diagonals])
        directions = np.concatenate([half, -half])
        return Hull(directions, (x @ directions.T).max(axis=0))

    def outside(self, x: np.ndarray) -> np.ndarray:
        """(n,) how far x: (n, k) lies outside; 0 inside."""
        return np.maximum((x @ self.directions.T - self.reach).max(axis=1), 0.0)


@dataclass(frozen=True)
class Spread:
    """How sure a prediction is: covariance of the model's parameters and the readout, and what neither explains."""

    basis: np.ndarray  # (P, r) directions of the model's parameters, in their priors' sigmas
    covariance: np.ndarray  # (r + n_weights, r + n_weights)
    unexplained: float  # one sigma of each output that nothing explains, in units of `Correction.scale`
    inflation: float  # by cross-validation: of all this

    def of(self, by_model: np.ndarray, by_output: np.ndarray, units: np.ndarray | None) -> np.ndarray:
        """(n, rows, rows): covariance of predictions with derivatives (n, rows, P) and (n, rows, k).

        by_output: of the scaled outputs; units: (n, rows, n_weights), None: the model alone.
        """
        by_data = by_model @ self.basis
        columns = by_data if units is None else np.concatenate([by_data, units], axis=2)
        rest = self.unexplained**2 * by_output @ by_output.swapaxes(1, 2)
        return self.inflation * (variance(columns, self.covariance) + rest)


@dataclass(frozen=True)
class Correction:
    """delta(x) of the outputs, and how far to go from the model alone towards the model refined with delta."""

    units: Units
    readout: np.ndarray  # (n_weights,)
    scale: np.ndarray  # (k,) of the outputs
    hull: Hull
    structure: str  # of STRUCTURES
    shrinkage: float  # 0 .. 1
    evidence: float  # by how many standard errors the correction pays in cross-validation
    losses: dict[str, float]  # by structure, in cross-validation: `Unseen.loss`; "" for the model alone
    alone: Spread  # of the model alone
    refined: Spread

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(n, k) at x: (n, k)."""
        return self.by_weights(x) @ self.readout

    def by_weights(self, x: np.ndarray) -> np.ndarray:
        """(n, k, n_weights): d delta / d readout."""
        joints, _ = self.units.layout
        return self.scale[:, None] * np.where(
            joints == np.arange(len(self.scale))[:, None], self.units.values(x)[:, None], 0.0
        )

    def waves(self) -> list[tuple[int, float, float]]:
        """(joint, period in readings, amplitude of the output) of the periodic errors, the largest first."""
        periodic = [wave for group in self.units.groups if isinstance(group, Waves) for wave in group.periodic]
        pairs = self.readout[[name == Waves.name for name in self.units.layout[1]]].reshape(-1, 2)
        waves = []
        for (joint, cycles), pair in zip(periodic, pairs, strict=True):
            j = int(joint)
            amplitude = self.shrinkage * self.scale[j] * float(np.hypot(*pair))
            waves.append((j, float(2 * self.units.span[j] / cycles), float(amplitude)))
        return sorted(waves, key=lambda wave: -wave[2])

    def share(self, x: np.ndarray) -> np.ndarray:
        """(n,) of the correction that is believed at x: shrinkage within the hull, falling smoothly to 0 outside."""
        return self.shrinkage * self.fade(x)

    def fade(self, x: np.ndarray) -> np.ndarray:
        """(n,) 1 inside the hull of the training inputs, falling smoothly to 0 outside."""
        distance = np.minimum(self.hull.outside(self.units.scaled(x)) / (2 * MARGIN), 1.0)  # a range is 2 wide
        return (1 - distance**2) ** 2
