"""A sweep summed up over its seeds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kincal.pipeline.report.numbers import significant
from kincal.pipeline.report.tables import Table
from kincal.pipeline.studies.rows import UNITS, records
from kincal.pipeline.studies.sweep import Sweep

if TYPE_CHECKING:
    import pandas as pd


def medians(sweep: Sweep) -> pd.DataFrame:
    """One row a combination of swept values and method: jobs, median and quartiles of the mean errors over seeds."""
    import pandas as pd

    table = sweep.table[sweep.table["method"].notna()]
    groups = table.groupby([*sweep.keys, "method"], sort=False)
    columns = {"jobs": groups["seed"].size()}
    for mean in UNITS:
        for name, share in ((mean, 0.5), (f"{mean}_low", 0.25), (f"{mean}_high", 0.75)):
            columns[name] = groups[mean].quantile(share)
    return pd.DataFrame(columns).reset_index()


def measured_units(table: pd.DataFrame) -> list[str]:
    """mean_deg, mean_mm: those that `medians` has numbers of."""
    return [mean for mean in UNITS if any(table[mean].notna())]


def median_tables(sweep: Sweep) -> list[tuple[str, Table]]:
    """For people: one row a combination of swept values, one column a method; what was not measured has no table."""
    table = medians(sweep)
    methods = list(dict.fromkeys(table["method"]))
    n = len(set(sweep.table["seed"][sweep.table["method"].notna()]))
    tables = []
    for mean in measured_units(table):
        rows: dict[tuple[str, ...], dict[str, str]] = {}
        for row in records(table):
            label = tuple(str(row[key]) for key in sweep.keys) or (sweep.robot,)
            cells = rows.setdefault(label, {"jobs": str(row["jobs"])})
            cells[row["method"]] = significant(row[mean])
        columns = (*(sweep.keys or ["robot"]), "jobs", *methods)
        lines = tuple((*label, cells["jobs"], *(cells.get(m, "") for m in methods)) for label, cells in rows.items())
        title = f"median over {n} seed{'s' * (n > 1)} of the mean error [{UNITS[mean]}]"
        tables.append((title, Table(columns, lines)))
    return tables
