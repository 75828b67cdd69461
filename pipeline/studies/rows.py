"""A comparison as rows of one tidy table, one a method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kincal.pipeline.results import Comparison

if TYPE_CHECKING:
    import pandas as pd

_NUMBERS = ("mean_deg", "max_deg", "sd_deg", "x_deg", "y_deg", "z_deg", "mean_mm", "max_mm", "sd_mm")
_OTHER_NUMBERS = ("closed_loop_mean_deg", "closed_loop_mean_mm", "held_out_mean_deg", "held_out_mean_mm")
METHOD_NUMBERS = (*_NUMBERS, *_OTHER_NUMBERS)
UNITS = {"mean_deg": "deg", "mean_mm": "mm"}


def method_rows(compared: Comparison) -> list[dict[str, Any]]:
    """A comparison as rows, one a method."""
    closed = {score.name: score for score in compared.closed_loop}
    held_out = {score.name: score for score in compared.held_out}
    rows = []
    for score in compared.methods:
        row = {"method": score.name, "scored_on": compared.scored_on, "n_poses": compared.n_poses}
        row |= {number: getattr(score, number) for number in _NUMBERS if hasattr(score, number)}
        row |= {f"{axis}_deg": score.axis_mean_deg[axis] for axis in "xyz"}
        for group, scores in (("closed_loop", closed), ("held_out", held_out)):
            row |= {f"{group}_{mean}": getattr(scores[score.name], mean) for mean in UNITS if score.name in scores}
        rows.append(row)
    return rows


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of plain values, None where there is none."""
    columns = {str(name): zip(c.tolist(), c.isna(), strict=True) for name, c in table.items()}
    plain = {name: [None if empty else v for v, empty in cells] for name, cells in columns.items()}
    return [dict(zip(plain, row, strict=True)) for row in zip(*plain.values(), strict=True)]
