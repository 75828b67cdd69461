"""What changed between two campaigns, for people."""

from __future__ import annotations

import numpy as np

from kincal.identification.changes import Changes
from kincal.identification.identification import HUMAN
from kincal.pipeline.report.numbers import fixed, significant
from kincal.pipeline.report.parameters import decimals
from kincal.pipeline.report.tables import Table

_SHOWN = 12  # parameters
CHANCE = 1e-4  # that a robot which did not change is said to have changed


def change_lines(changes: Changes, before: str, after: str) -> list[str]:
    """A sentence each; before, after: the names of the campaigns."""
    names = ", ".join(changes.names[k] for k in changes.likely)
    size = f"chi-square {significant(changes.chi_square)} over {changes.freedom} degrees of freedom"
    size = f"({size}, p = {changes.p_value:.2g})"
    if changes.p_value >= CHANCE:
        return [f"From {before} to {after}: no significant change {size}."]
    line = f"From {before} to {after}: the robot changed {size}."
    if not names:
        return [line, "No change of a single parameter explains it."]
    alike = " (one of these alone; the measurements cannot tell them apart)" if len(changes.likely) > 1 else ""
    return [line, f"Best explanation: a change of {names}{alike}."]


def change_table(changes: Changes) -> Table:
    """The parameters that explain most, each as if it alone had changed."""
    rows: list[tuple[str, ...]] = []
    for k in np.argsort(-np.abs(changes.sigmas), kind="stable")[:_SHOWN].tolist():
        sigmas = float(changes.sigmas[k])
        if abs(sigmas) < changes.limit:
            break
        unit, factor = HUMAN[changes.units[k]]
        change, std = float(changes.change[k]) * factor, float(changes.std[k]) * factor
        digits = decimals(std)
        rows.append((changes.names[k], unit, fixed(change, digits), fixed(std, digits), fixed(sigmas, 1)))
    return Table(("parameter, if it alone changed", "unit", "change", "sigma", "in sigmas"), tuple(rows))
