"""Identified parameters for people and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kincal.identification.identification import HUMAN, Identification
from kincal.pipeline.report.numbers import fixed
from kincal.pipeline.report.tables import Table
from kincal.urdf.description import SENSORS

_CONDITION_INDEX, _PROPORTION, _INFLATION = 30.0, 0.5, 10.0  # Belsley, Kuh, Welsch 1980: worth a word beyond
_Z95 = 1.959964  # of a normal distribution: 95 % lie within


def parameter_table(identification: Identification) -> Table:
    """One row a parameter, in millimetres and degrees."""
    rows = []
    for k, name in enumerate(identification.names):
        unit, factor = HUMAN[identification.units[k]]
        nominal, change, std = (
            identification.nominal[k] * factor,
            identification.change[k] * factor,
            identification.std[k] * factor,
        )
        digits = decimals(std)
        cells = [fixed(value, digits) for value in (nominal, nominal + change, change)]
        cells.append(fixed(std, digits) if np.isfinite(std) else "")
        moved = identification.change[k] / identification.tolerance[k]
        cells += [
            fixed(moved, 1) if np.isfinite(identification.tolerance[k]) else "",
            f"{100 * identification.data_share[k]:.0f} %",
        ]
        rows.append((name, unit, *cells, _seen(identification, k)))
    columns = ("parameter", "unit", "nominal", "identified", "change", "sigma", "in tolerances")
    return Table((*columns, "from data", "identifiable"), tuple(rows))


def foreseen_table(identification: Identification) -> Table:
    """One row a parameter, before anybody has measured: what is known of it, and what will be."""
    rows = []
    for k, name in enumerate(identification.names):
        unit, factor = HUMAN[identification.units[k]]
        std, tolerance = identification.std[k] * factor, identification.tolerance[k] * factor
        cells = [f"{identification.nominal[k] * factor:.4f}", f"{tolerance:.4g}" if np.isfinite(tolerance) else ""]
        cells += [f"{std:.{decimals(std)}f}" if np.isfinite(std) else "", f"{100 * identification.data_share[k]:.0f} %"]
        rows.append((name, unit, *cells, _seen(identification, k)))
    columns = ("parameter", "unit", "nominal", "tolerance", "sigma after", "from data", "identifiable")
    return Table(columns, tuple(rows))


def decimals(std: float) -> int:
    """So many that two digits of sigma show."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 8)) if np.isfinite(std) and std > 0 else 6


def _seen(identification: Identification, k: int) -> str:
    return "yes" if identification.identifiable[k] else f"{100 * identification.observable_share[k]:.0f} %"


def correlations(identification: Identification, above: float = 0.9) -> list[tuple[str, str, float]]:
    """Pairs of parameters whose estimates are correlated by more than `above`, the strongest first."""
    std = np.sqrt(np.diag(identification.covariance))
    known = np.flatnonzero((std > 0) & np.isfinite(identification.std))
    r = identification.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    first, second = np.nonzero(np.triu(np.abs(r) > above, 1))
    order = np.argsort(-np.abs(r[first, second]), kind="stable")
    names = [identification.names[k] for k in known]
    return [(names[first[k]], names[second[k]], float(r[first[k], second[k]])) for k in order]


def collinear_lines(identification: Identification, most: int = 5) -> list[str]:
    """Belsley's diagnostics in words: near dependencies, and the parameters that take part."""
    c = identification.collinearity
    high = [k for k in np.argsort(-c.condition_indexes) if c.condition_indexes[k] > _CONDITION_INDEX]
    inflated = np.argsort(-c.inflation)
    n_inflated = int(np.sum(c.inflation > _INFLATION))
    lines = [
        f"{len(high)} condition indexes above {_CONDITION_INDEX:g} and {n_inflated} variance inflation factors above "
        f"{_INFLATION:g}, of {len(c.parameters)} parameters that the data tell apart"
    ]
    for k in high[:most]:
        shares = c.proportions[k]
        taking = [j for j in np.argsort(-shares) if shares[j] > _PROPORTION]
        named = ", ".join(f"{c.parameters[j]} {100 * shares[j]:.0f} %" for j in taking[:most]) or "none above half"
        more = f" and {len(taking) - most} more" if len(taking) > most else ""
        lines.append(f"  index {c.condition_indexes[k]:.3g}: variance of {named}{more}")
    if n_inflated:
        worst = ", ".join(f"{c.parameters[j]} {c.inflation[j]:.3g}" for j in inflated[: min(most, n_inflated)])
        lines.append(f"  most inflated: {worst}")
    return lines


def sensor_sigmas(identification: Identification) -> str:
    """One sigma of each channel, for people. Units by the names of [sensor]: channels themselves load casadi."""
    factors = dict(HUMAN.values())
    parts = []
    for name, sigma in identification.sensor_std.items():
        unit, _ = SENSORS[name]
        parts.append(f"{name} {factors[unit] * sigma:.3g} {unit}")
    return "; ".join(parts)


def summary_lines(identification: Identification) -> list[str]:
    """Rank decision, conditioning and collinearity, correlations; what an engineer asks before the numbers."""
    s, rank = identification.singular_values, identification.rank
    below = f", the next is {s[rank]:.3g} (gap {identification.rank_gap:.1g})" if rank < len(s) else ""
    lines = [
        f"rank {rank} of {len(identification.names)} parameters: singular value {rank} is {s[rank - 1]:.3g}{below}, "
        f"tolerance {identification.rank_tolerance:.2g}; condition number {identification.condition_number:.3g}",
        *collinear_lines(identification),
    ]
    pairs = correlations(identification)
    listed = "; ".join(f"{a} and {b} {r:+.3f}" for a, b, r in pairs[:3])
    lines.append(f"{len(pairs)} pairs of estimates correlated by more than 0.9{': ' + listed if listed else ''}")
    return lines


def parameters_json(robot: str, identification: Identification) -> dict[str, Any]:
    """The document of `inspect --json`: SI units and radians; null where neither data nor prior see a parameter."""
    parameters = []
    for k, name in enumerate(identification.names):
        identified, std = identification.nominal[k] + identification.change[k], identification.std[k]
        parameters.append(
            {
                "name": name,
                "unit": identification.units[k],
                "nominal": float(identification.nominal[k]),
                "identified": float(identified),
                "change": float(identification.change[k]),
                "std": _finite(std),
                "low": _finite(identified - _Z95 * std),
                "high": _finite(identified + _Z95 * std),
                "identifiable": bool(identification.identifiable[k]),
                "observable_share": float(identification.observable_share[k]),
                "tolerance": _finite(identification.tolerance[k]),
                "change_in_tolerances": _finite(identification.change[k] / identification.tolerance[k]),
                "data_share": float(identification.data_share[k]),
                "prior_share": float(1 - identification.data_share[k]),
            }
        )
    c = identification.collinearity
    return {
        "robot": robot,
        "n_poses": identification.n_poses,
        "channels": list(identification.channels),
        "sensor_std": identification.sensor_std,
        "sensor_estimated": identification.sensor_estimated,
        "estimator": identification.estimator,
        "loss": identification.loss,
        "shrinkage": identification.shrinkage,
        "rank": identification.rank,
        "n_parameters": len(identification.names),
        "condition_number": _finite(identification.condition_number),
        "rank_tolerance": identification.rank_tolerance,
        "rank_gap": _finite(identification.rank_gap),
        "singular_values": identification.singular_values.tolist(),
        "parameters": parameters,
        "unobservable": list(identification.unobservable),
        "unobservable_basis": identification.unobservable_basis.tolist(),
        "collinearity": {
            "parameters": list(c.parameters),
            "variance_inflation": c.inflation.tolist(),
            "condition_indexes": c.condition_indexes.tolist(),
            "variance_proportions": c.proportions.tolist(),
        },
        "correlations": [{"parameters": [a, b], "correlation": r} for a, b, r in correlations(identification)],
        "chi_square": identification.chi_square,
        "degrees_of_freedom": identification.degrees_of_freedom,
        "iterations": identification.iterations,
        "message": identification.message,
        "residual_rms": _si(identification.residual_size),
        "outliers": [vars(outlier) for outlier in identification.outliers],
        "findings": list(identification.findings),
    }


def foreseen_json(robot: str, identification: Identification, more: dict[str, Any]) -> dict[str, Any]:
    """The document of `inspect --before --json`: without what only readings tell."""
    document = parameters_json(robot, identification)
    for key in ("chi_square", "degrees_of_freedom", "iterations", "message", "residual_rms", "outliers"):
        del document[key]
    for parameter in document["parameters"]:
        for key in ("identified", "change", "low", "high", "change_in_tolerances"):
            del parameter[key]
    return document | more


def _si(sizes: Mapping[str, float | None]) -> dict[str, float | None]:
    """{name: m or rad} of {name_mm or name_deg: for people}; the actuators' are actuators_m and actuators_rad."""
    names = {"prismatic_mm": "actuators_m", "revolute_deg": "actuators_rad"}
    factors = {"mm": 1e-3, "deg": np.pi / 180}
    return {
        names.get(name, name.rpartition("_")[0]): None
        if size is None
        else float(size * factors[name.rpartition("_")[2]])
        for name, size in sizes.items()
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
