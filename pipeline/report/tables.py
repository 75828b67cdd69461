"""What people read: results as rows of text, in degrees and millimetres. Shared by the terminal and the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kincal.identification.identification import HUMAN
from kincal.learning.correction import Correction
from kincal.pipeline.report.numbers import significant
from kincal.pipeline.results import MethodScore, Model


@dataclass(frozen=True)
class Table:
    """Cells of text."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def comparison_tables(methods: Sequence[MethodScore], raw: MethodScore | None = None) -> tuple[Table, ...]:
    """One row a method: orientation errors, then position errors; only channels that were measured have a table."""
    rows = [*([raw] if raw else []), *methods]
    tables = []
    if rows and rows[0].mean_deg is not None:
        cells = ([significant(v) for v in (r.mean_deg, r.max_deg, r.sd_deg, *r.axis_mean_deg.values())] for r in rows)
        tables.append(_by_method(rows, ("mean [deg]", "max [deg]", "SD [deg]", "x [deg]", "y [deg]", "z [deg]"), cells))
    if rows and rows[0].mean_mm is not None:
        cells = ([significant(v) for v in (r.mean_mm, r.max_mm, r.sd_mm)] for r in rows)
        tables.append(_by_method(rows, ("mean [mm]", "max [mm]", "SD [mm]"), cells))
    return tuple(tables)


def _by_method(rows: Sequence[MethodScore], columns: tuple[str, ...], cells: Iterable[list[str]]) -> Table:
    return Table(("method", *columns), tuple((r.name, *line) for r, line in zip(rows, cells, strict=True)))


def structure_table(correction: Correction) -> Table:
    """One row a structure of the correction: its score in cross-validation, lower is better."""
    rows = ((name or "geometry alone", significant(loss, 4)) for name, loss in correction.losses.items())
    return Table(("structure", "score"), tuple(rows))


def wave_table(correction: Correction, model: Model) -> Table:
    """One row a periodic error of an actuator, the largest first; periods in its readings."""
    chain = model.chain()
    rows = []
    for joint, period, amplitude in correction.waves():
        sliding = chain.prismatic[chain.actuated[joint]]
        unit, factor = HUMAN["m" if sliding else "rad"]
        rows.append((chain.actuated_names[joint], f"{period:.4g}", f"{amplitude * factor:.2g} {unit}"))
    return Table(("actuator", "period [reading]", "amplitude"), tuple(rows))
