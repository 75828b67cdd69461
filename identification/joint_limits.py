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


@dataclass(frozen=True)
class Beyond:
    """The first joint value that is beyond its limits, in words."""

    where: str
    column: str
    row: int
    units: tuple[str, ...]  # in which all values of the joint lie within the limits

    def error(self, cause: str = "") -> TableError:
        """With the cause, where one is known; else a unit is asked after."""
        text = f"; likely cause: {cause}" if cause else ""
        if self.units and not cause:
            text = f"; is it in {' or '.join(self.units)}? (measure.columns gives a column's unit)"
        return TableError(f"{self.where}{text}", self.column, self.row)


def check_readings(
    table: pd.DataFrame, chain: ClosedChain, actuators: Actuators, tolerance: Tolerance, file: Path | str
) -> None:
    """Refuse joint values beyond the URDF's limits (three tolerances of zero and gain are forgiven)."""
    beyond = beyond_limits(table, chain, actuators, tolerance, file)
    if beyond is not None:
        raise beyond.error()


def beyond_limits(
    table: pd.DataFrame, chain: ClosedChain, actuators: Actuators, tolerance: Tolerance, file: Path | str
) -> Beyond | None:
    """What `check_readings` refuses."""
    for k, name in enumerate(chain.actuated_names):
        joint, zero = chain.actuated[k], float(actuators.zero[k])
        moves, slides = actuators.gain[k] * table[name].to_numpy(float), chain.prismatic[joint]
        forgiven = tolerance.actuator_zero_mm * 1e-3 if slides else np.deg2rad(tolerance.actuator_zero_deg)
        limits = _Limits(
            float(chain.lower[joint]), float(chain.upper[joint]), 3 * forgiven, 3 * tolerance.actuator_gain
        )
        bad = np.flatnonzero(limits.beyond(moves, zero))
        if len(bad):
            row, units = int(bad[0]), LENGTHS if slides else ANGLES
            return Beyond(
                f"{file}: pose {table['pose'][row]}: joint {quoted(name)} would be at {zero + moves[row]:.6g} "
                f"{units[0]}; its limits are [{limits.low:.6g}, {limits.high:.6g}]",
                name,
                row,
                tuple(unit for unit in units if not limits.beyond(moves * UNITS[unit], zero).any()),
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
