"""What an engineer reads first of an identification: the verdict, the findings, the parameters that moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kincal.identification.identification import HUMAN, Identification
from kincal.pipeline.report.numbers import fixed
from kincal.pipeline.report.parameters import decimals
from kincal.pipeline.report.tables import Table

_MOVED = 2.0  # sigmas
_NO_EFFECT = " has no effect on the measurements"  # how `identifiability` writes such a direction
_ROWS = 24  # of the table; more are in --all


def verdict_line(identification: Identification) -> str:
    """One sentence: whether there is anything to check before the result is used."""
    n, outliers = len(identification.findings), len(identification.outliers)
    if not n and not outliers:
        return "Verdict: good. The geometry explains the measurements, and no parameter moved far from its drawing."
    parts = [f"{n} finding{'s' * (n > 1)}"] * (n > 0) + [f"{outliers} outlier{'s' * (outliers > 1)}"] * (outliers > 0)
    return f"Verdict: check {' and '.join(parts)} before you use the result."


def finding_lines(findings: Sequence[str], outliers: Sequence[tuple[int, str]], most: int = 10) -> list[str]:
    """Findings and outliers, a line each; outliers: (pose, reason)."""
    lines = [f"Finding: {finding}." for finding in findings]
    lines += [f"Outlier: pose {pose}: {reason}." for pose, reason in outliers[:most]]
    if len(outliers) > most:
        lines.append(f"... and {len(outliers) - most} more outliers.")
    return lines


def moved_table(identification: Identification) -> tuple[Table, int]:
    """Identifiable parameters that moved by more than two sigmas, grouped by part; and how many more there are."""
    rows: list[tuple[str, ...]] = []
    moved = np.abs(identification.change) > _MOVED * identification.std
    chosen = np.flatnonzero(moved & identification.identifiable)
    if len(chosen) > _ROWS:  # the most significant ones
        ratio = np.abs(identification.change[chosen]) / identification.std[chosen]
        shown = np.sort(chosen[np.argsort(-ratio)[:_ROWS]])
    else:
        shown = chosen
    before = ""
    for k in shown:
        part, _, name = identification.names[k].rpartition(".")
        unit, factor = HUMAN[identification.units[k]]
        nominal, change, std = (float(getattr(identification, key)[k]) * factor for key in ("nominal", "change", "std"))
        digits, tolerance = decimals(std), identification.tolerance[k]
        cells = [fixed(value, digits) for value in (nominal, nominal + change, change, std)]
        in_tolerances = fixed(identification.change[k] / tolerance, 1) if np.isfinite(tolerance) else ""
        rows.append((part if part != before else "", name, unit, *cells, in_tolerances))
        before = part
    columns = ("part", "parameter", "unit", "nominal", "identified", "change", "sigma", "in tolerances")
    return Table(columns, tuple(rows)), len(chosen) - len(shown)


def direction_lines(unobservable: Sequence[str]) -> list[str]:
    """The directions that are not determined; parameters without any effect share one line."""
    alone = [text.removesuffix(_NO_EFFECT) for text in unobservable if text.endswith(_NO_EFFECT)]
    lines = [f"no effect on the measurements: {', '.join(alone)}"] if alone else []
    return lines + [text for text in unobservable if not text.endswith(_NO_EFFECT)]


def rank_line(identification: Identification) -> str:
    """How much of the geometry the measurements determine."""
    n, rank, alone = len(identification.names), identification.rank, int(identification.identifiable.sum())
    return (
        f"The measurements determine {rank} of {n} parameter combinations; {alone} parameters are identifiable on "
        "their own."
    )
