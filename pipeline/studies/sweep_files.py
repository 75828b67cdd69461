"""What a sweep leaves: its table, its figure, and its document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kincal.pipeline.store.files import refusing, replace_file
from kincal.pipeline.studies.medians import medians
from kincal.pipeline.studies.rows import records
from kincal.pipeline.studies.sweep import Sweep


def sweep_json(sweep: Sweep, table: Path | None, figure: Path | None) -> dict[str, Any]:
    """The document of `sweep --json`."""
    return {
        "robot": sweep.robot,
        "over": {over.key: list(over.values) for over in sweep.overs},
        "jobs": len(sweep.outcomes),
        "failed": sweep.n_failed,
        "table": None if table is None else str(table),
        "figure": None if figure is None else str(figure),
        "medians": records(medians(sweep)),
        "rows": records(sweep.table),
    }


def write(sweep: Sweep, folder: Path) -> tuple[Path, Path | None]:
    """sweep.parquet, and sweep.svg where a number was swept; what stood there is replaced at once."""
    over = next((o for o in sweep.overs if o.numeric and o.key != "seed" and len(o.texts) > 1), None)
    drawn = None
    if over is not None and any(sweep.table["method"].notna()):
        from kincal.pipeline.studies.sweep_figure import drawing

        drawn = drawing(sweep, over.key)
    table, figure = folder / "sweep.parquet", folder / "sweep.svg"
    with refusing(f"--output {folder}"):
        replace_file(table, sweep.table.to_parquet(index=False))
        if drawn is not None:
            replace_file(figure, drawn.encode())
        else:
            figure.unlink(missing_ok=True)  # of an earlier sweep
    return table, figure if drawn is not None else None
