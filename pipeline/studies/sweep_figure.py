"""The figure of a sweep: median and quartiles over seeds against a swept number, one line a method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kincal.pipeline.report.figures import STYLE, clean, quartile_line, svg
from kincal.pipeline.studies.medians import measured_units, medians
from kincal.pipeline.studies.rows import UNITS
from kincal.pipeline.studies.sweep import Sweep
from kincal.urdf.errors import one_line

if TYPE_CHECKING:
    import pandas as pd

_MOST_ROWS = 8  # combinations of the other swept values


def drawing(sweep: Sweep, key: str) -> str:
    """An SVG whose bytes depend on the results alone. One column a unit, one row a combination of the other values."""
    table = medians(sweep)
    units = measured_units(table)
    others = [other for other in sweep.keys if other != key]
    parts: list[tuple[Any, Any]] = list(table.groupby(others, sort=False)) if others else [((), table)]
    shown = parts[:_MOST_ROWS]
    with rc_context(STYLE):
        size = (0.6 + 5.4 * len(units), 0.6 + 3.4 * len(shown))
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(len(shown), len(units), squeeze=False, sharex=True)
        for line, (values, part) in zip(panels, shown, strict=True):
            for axes, mean in zip(line, units, strict=True):
                _draw(part, key, mean, axes)
                title = ", ".join(f"{k} = {v}" for k, v in zip(others, values, strict=True))
                axes.set_title(one_line(title), fontsize=9, parse_math=False)
        for axes in panels[-1]:
            axes.set_xlabel(key)
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
        n = len(set(sweep.table["seed"]))
        left_out = f"; the first {len(shown)} of {len(parts)} combinations" if len(parts) > len(shown) else ""
        of_seeds = f"median and quartiles over {n} seeds" if n > 1 else "one seed"
        figure.suptitle(f"{sweep.robot}: {of_seeds}{left_out}", fontsize=10)
        return svg(figure)


def _draw(part: pd.DataFrame, key: str, mean: str, axes: Any) -> None:
    columns = [key, mean, f"{mean}_low", f"{mean}_high"]
    for name, rows in part.groupby("method", sort=False):
        quartile_line(axes, str(name), *rows.sort_values(by=key)[columns].to_numpy(float, na_value=np.nan).T)
    axes.set_yscale("log")
    axes.set_ylabel(f"mean error [{UNITS[mean]}]")
    clean(axes)
