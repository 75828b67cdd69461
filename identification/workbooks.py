"""Spreadsheets: the first sheet that has a measurement table's header."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from kincal.identification.dialect import folded, header_of, units_of
from kincal.urdf.description import Measure, listed
from kincal.urdf.errors import InputError, quoted

WORKBOOKS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
_LOOKED_AT = 200  # rows for the header


def workbook(file: Path, measure: Measure, wanted: Sequence[str]) -> pd.DataFrame:
    """The table of a spreadsheet, read by calamine. Raises InputError where no sheet has a header that is known."""
    names = {folded(name) for name in (*wanted, *(column.source for column in measure.columns.values()))}
    sheets = pd.read_excel(file, sheet_name=None, header=None, dtype=object, engine="calamine")
    for sheet, cells in sheets.items():
        rows = cells.head(_LOOKED_AT).astype(object).where(cells.notna(), None).to_numpy().tolist()
        row = measure.header_row - 1 if measure.header_row is not None else header_of(rows, names)
        if row is None or row >= len(rows):
            continue
        return _table(file, str(sheet), cells, row, len(sheets))
    raise InputError(
        f"{file}: no sheet of {listed(sheets)} has a row with the names of joints and measured columns; set "
        "measure.header_row, or save the table as CSV"
    )


def _table(file: Path, sheet: str, cells: pd.DataFrame, row: int, n_sheets: int) -> pd.DataFrame:
    heading = cells.iloc[row]
    kept = [k for k in cells.columns if isinstance(heading[k], str) and heading[k].strip()]
    names = [str(heading[k]).strip() for k in kept]
    table = cells.loc[row + 1 :, kept].set_axis(names, axis="columns").dropna(how="all").reset_index(drop=True)
    units = units_of(names, table.iloc[0].where(table.iloc[0].notna(), "").tolist()) if len(table) else {}
    table = table.iloc[1:].reset_index(drop=True) if units else table
    notes = [f"{file}: read sheet {quoted(sheet)}"] * (n_sheets > 1)
    notes += [f"{file}: recognised measure.header_row = {row + 1}"] * (row > 0)
    table.attrs.update(notes=tuple(notes), units=units)
    return table
