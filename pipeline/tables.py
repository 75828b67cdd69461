"""What people read: results as rows of text, in degrees and millimetres. Shared by the terminal and the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from identification.identification import Identification
from pipeline.results import MethodScore

_HUMAN = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180 / np.pi),
    "m/reading": ("mm/reading", 1e3),
    "rad/reading": ("deg/reading", 180 / np.pi),
}
_Z95 = 1.959964  # of a normal distribution: 95 % lie within


@dataclass(frozen=True)
class Table:
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def comparison_tables(methods: Sequence[MethodScore], raw: MethodScore | None = None) -> tuple[Table, ...]:
    """One row a method: orientation errors, then position errors; only what was measured has a table."""
    rows = [*([raw] if raw else []), *methods]
    found = []
    if rows and rows[0].mean_deg is not None:
        cells = ([fixed(v, 5) for v in (r.mean_deg, r.max_deg, r.sd_deg, *r.axis_mean_deg.values())] for r in rows)
        found.append(_by_method(rows, ("mean [deg]", "max [deg]", "SD [deg]", "x [deg]", "y [deg]", "z [deg]"), cells))
    if rows and rows[0].mean_mm is not None:
        cells = ([fixed(v, 4) for v in (r.mean_mm, r.max_mm, r.sd_mm)] for r in rows)
        found.append(_by_method(rows, ("mean [mm]", "max [mm]", "SD [mm]"), cells))
    return tuple(found)


def _by_method(rows: Sequence[MethodScore], columns: tuple[str, ...], cells: Iterable[list[str]]) -> Table:
    return Table(("method", *columns), tuple((r.name, *line) for r, line in zip(rows, cells, strict=True)))


def parameter_table(found: Identification) -> Table:
    """One row a parameter, in millimetres and degrees."""
    rows = []
    for k, name in enumerate(found.names):
        unit, factor = _HUMAN[found.units[k]]
        nominal, change, std = found.nominal[k] * factor, found.change[k] * factor, found.std[k] * factor
        known = bool(np.isfinite(std))
        digits = int(np.clip(2 - np.floor(np.log10(std)), 0, 8)) if known and std > 0 else 6  # three of sigma's
        low, high = nominal + change - _Z95 * std, nominal + change + _Z95 * std
        cells = [f"{value:.{digits}f}" for value in (nominal, nominal + change, change)]
        cells += [f"{std:.{digits}f}", f"{low:.{digits}f} .. {high:.{digits}f}"] if known else ["", ""]
        seen = "yes" if found.identifiable[k] else f"{100 * found.observable_share[k]:.0f} %"
        rows.append((name, unit, *cells, seen))
    columns = ("parameter", "unit", "nominal", "identified", "change", "sigma", "95 % interval", "identifiable")
    return Table(columns, tuple(rows))


def parameters_json(robot: str, found: Identification) -> dict[str, Any]:
    """The document of `inspect --json`: SI units and radians; null where neither data nor prior see a parameter."""

    def finite(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    parameters = []
    for k, name in enumerate(found.names):
        identified, std = found.nominal[k] + found.change[k], found.std[k]
        parameters.append(
            {
                "name": name,
                "unit": found.units[k],
                "nominal": float(found.nominal[k]),
                "identified": float(identified),
                "change": float(found.change[k]),
                "std": finite(std),
                "low": finite(identified - _Z95 * std),
                "high": finite(identified + _Z95 * std),
                "identifiable": bool(found.identifiable[k]),
                "observable_share": float(found.observable_share[k]),
                "tolerance": finite(found.tolerance[k]),
            }
        )
    return {
        "robot": robot,
        "n_poses": found.n_poses,
        "channels": list(found.channels),
        "rank": found.rank,
        "n_parameters": len(found.names),
        "condition_number": finite(found.condition_number),
        "rank_tolerance": found.rank_tolerance,
        "singular_values": found.singular_values.tolist(),
        "parameters": parameters,
        "unobservable": list(found.unobservable),
        "chi_square": found.chi_square,
        "degrees_of_freedom": found.degrees_of_freedom,
        "iterations": found.iterations,
        "residual_rms": vars(found.residual_size),
        "outliers": [vars(outlier) for outlier in found.outliers],
    }
