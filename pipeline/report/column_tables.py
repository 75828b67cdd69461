"""What is recognised in a table, as text for people."""

from __future__ import annotations

from kincal.identification.column_report import ColumnReport, TableReport
from kincal.pipeline.report.tables import Table

_HEADINGS = ("column", "kincal reads", "meaning", "unit", "lowest", "highest", "blank cells")
_LONGEST = 40  # letters of a name


def column_table(report: TableReport) -> Table:
    """One row a column of the file."""
    return Table(_HEADINGS, tuple(_row(column) for column in report.columns))


def closing_lines(report: TableReport, with_robot: bool) -> list[str]:
    """What is missing, and what to do."""
    lines = []
    proposed = [f"{c.name} as {c.proposed}" for c in report.columns if c.proposed]
    if proposed:
        lines.append(f"Proposed: {', '.join(proposed[:12])}. With --write: these as [measure.columns].")
    if report.missing:
        cure = " Set measure.joints to a table that has them." if report.is_export else ""
        lines.append(f"No column for the joints {', '.join(report.missing[:12])}.{cure}")
    if not with_robot and not report.is_export:
        lines.append("Columns of joints are not known without a robot: kincal columns FILE ROBOT.")
    return lines


def _row(column: ColumnReport) -> tuple[str, ...]:
    low, high = ("text" if value is None else f"{value:.6g}" for value in (column.low, column.high))
    reads = column.canonical or (f"{column.proposed}?" if column.proposed else "-")
    name = column.name if len(column.name) <= _LONGEST else column.name[: _LONGEST - 3] + "..."
    return (name, reads, column.meaning, column.unit or "-", low, high, str(column.blank))
