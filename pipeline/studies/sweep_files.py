"""What a sweep leaves: its table, its figure, and its document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kincal.pipeline.store.files import refusing, replace_file
from kincal.pipeline.studies.medians import medians
from kincal.pipeline.studies.rows import records
from kincal.pipeline.studies.sweep import Swept


def sweep_json(swept: Swept, table: Path | None, figure: Path | None) -> dict[str, Any]:
    """The document of `sweep --json`."""
    return {
        "robot": swept.robot,
        "over": {over.key: list(over.values) for over in swept.overs},
        "jobs": swept.n_jobs,
        "failed": len(swept.failures),
        "table": None if table is None else str(table),
        "figure": None if figure is None else str(figure),
        "medians": records(medians(swept)),
        "rows": records(swept.table),
    }


def write(swept: Swept, folder: Path) -> tuple[Path, Path | None]:
    """sweep.parquet, and sweep.svg where a number was swept; what stood there is replaced at once."""
    over = next((o for o in swept.overs if o.numeric and o.key != "seed" and len(o.texts) > 1), None)
    drawn = None
    if over is not None and any(swept.table["method"].notna()):
        from kincal.pipeline.studies.sweep_figure import drawing

        drawn = drawing(swept, over.key)
    table, figure = folder / "sweep.parquet", folder / "sweep.svg"
    with refusing(f"--output {folder}"):
        replace_file(table, swept.table.to_parquet(index=False))
        if drawn is not None:
            replace_file(figure, drawn.encode())
        else:
            figure.unlink(missing_ok=True)  # of an earlier sweep
    return table, figure if drawn is not None else None
