"""Joint values beyond the limits of the URDF: no reading of this robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.measurement_table import ANGLES, LENGTHS, UNITS
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Tolerance
from kincal.urdf.errors import TableError, quoted


def check_readings(
    table: pd.DataFrame, chain: ClosedChain, actuators: Actuators, tolerance: Tolerance, file: Path | str
) -> None:
    """Refuse joint values beyond the URDF's limits (three tolerances of zero and gain are forgiven)."""
    error = beyond_limits(table, chain, actuators, tolerance, file)
    if error is not None:
        raise error


def beyond_limits(
    table: pd.DataFrame, chain: ClosedChain, actuators: Actuators, tolerance: Tolerance, file: Path | str
) -> TableError | None:
    """What `check_readings` raises; a unit is asked after where all values of the joint lie within the limits in it."""
    for k, name in enumerate(chain.actuated_names):
        joint, readings = chain.actuated[k], table[name].to_numpy(float)
        slides = chain.prismatic[joint]
        zero = tolerance.actuator_zero_mm * 1e-3 if slides else np.deg2rad(tolerance.actuator_zero_deg)
        limits = _Limits(float(chain.lower[joint]), float(chain.upper[joint]), 3 * zero, 3 * tolerance.actuator_gain)
        bad = np.flatnonzero(limits.beyond(actuators.gain[k] * readings, actuators.zero[k]))
        if len(bad):
            units = {unit: actuators.gain[k] * readings * UNITS[unit] for unit in (LENGTHS if slides else ANGLES)}
            within = [unit for unit, moves in units.items() if not limits.beyond(moves, actuators.zero[k]).any()]
            hint = f"; is it in {' or '.join(within)}? (measure.columns gives a column's unit)" if within else ""
            row = int(bad[0])
            return TableError(
                f"{file}: pose {table['pose'][row]}: joint {quoted(name)} would be at "
                f"{actuators.zero[k] + actuators.gain[k] * readings[row]:.6g} {'m' if slides else 'rad'}; "
                f"its limits are [{limits.low:.6g}, {limits.high:.6g}]{hint}",
                name,
                row,
            )
    return None


@dataclass(frozen=True)
class _Limits:
    """A joint's limits, and what is forgiven of the zero, and of the gain as a share of the move."""

    low: float
    high: float
    zero: float
    gain: float

    def beyond(self, moves: np.ndarray, zero: float) -> np.ndarray:
        """(n,) bool: of joints at zero + moves (n,)."""
        slack = self.zero + self.gain * np.abs(moves)
        return (zero + moves < self.low - slack) | (zero + moves > self.high + slack)
