"""A reproduction for people and programs: the page, the document, the tables of the terminal, and their files."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.report import paper
from kincal.pipeline.report.numbers import significant
from kincal.pipeline.report.paper import AXES, INDICES, RANGES
from kincal.pipeline.report.tables import Table
from kincal.pipeline.reproduce.claims import Claims, claims, claims_rows, pretraining
from kincal.pipeline.reproduce.study import Reproduced, Row
from kincal.pipeline.reproduce.tables import after_compensation, choices, figure_10, ranges, testing
from kincal.pipeline.results import RAW
from kincal.pipeline.store.files import replace_files

LABELS = {"nominal": "before calibration", "network": "BP network", "transfer": "transfer network"}  # in the paper
SCORED = {
    "fresh": "on 500 fresh poses, noise-free truth: the figures that count",
    "held_out": "as the paper does: on the 20 % held out, against the poses as measured",
}


@dataclass(frozen=True)
class Findings:
    """All that is made of the jobs' results."""

    document: dict[str, Any]  # results.json
    tables: dict[str, list[Row]]  # {file: its rows}
    figures: dict[str, str]  # {name: SVG}


def findings(results: Reproduced) -> Findings:
    from kincal.pipeline.reproduce.figures import figures

    cells, against_n, by_range, made = testing(results), figure_10(results), ranges(results), claims(results)
    tested, prior = claims_rows(made), pretraining(results)
    study = results.study
    document = {
        "schema": "kincal-reproduction-1",
        "paper": "Xu, Tian, Zhang: J. Mar. Sci. Eng. 2024, 12, 275",
        "robot": results.robot.name,
        "study": asdict(study),
        "jobs": sum(row["method"] == METHODS[0] for row in results.rows),
        "scored_on": SCORED,
        "verdicts": _verdicts(results, made),
        "choices": [asdict(choice) for choice in choices(results)],
        "claims": [asdict(c) | {"better": c.better, "fades": c.fades, "vanishes": c.vanishes} for c in made],
        "testing": cells,
        "after_compensation": after_compensation(results),
        "figure10": against_n,
        "ranges": by_range,
        "pretraining": prior,
        "differences": list(paper.differences(results.robot)),
    }
    tables = {
        "table1.csv": [row for row in cells if row["table"] == 1],
        "table2.csv": [row for row in cells if row["table"] == 2],
        "figure10.csv": against_n,
        "ranges.csv": by_range,
        "transfer_claims.csv": tested,
        "pretraining.csv": prior,
    }
    document = json.loads(json.dumps(document))  # plain values: keys are strings, tuples are lists
    return Findings(document, tables, figures(results, against_n, made, prior))


def _verdicts(results: Reproduced, made: list[Claims]) -> list[str]:
    verdicts = []
    for choice in (c for c in choices(results) if c.scored_on == "fresh"):
        advice = (
            f"{choice.range}: of the paper's two networks {choice.of_two} ({choice.why}); the paper: {choice.paper}"
        )
        over = choice.over_second
        ahead = f"{over.ratio:.2f} times better than {choice.second}, p = {over.p:.2g}"
        verdicts.append(f"{advice}. Of all six {choice.best}: {significant(choice.best_deg)} degrees, {ahead}")
    study = results.study
    ours_first = sorted((c for c in made if c.scored_on == "fresh"), key=lambda c: c.hidden != study.hidden)
    return verdicts + [f"H = {c.hidden}: {c.better}; {c.fades}; {c.vanishes}" for c in ours_first]


def cell(document: dict[str, Any], scored_on: str, method: str, axis: str, index: str) -> dict[str, Any]:
    """Of tables 1 and 2."""
    wanted = {"scored_on": scored_on, "method": method, "axis": axis, "index": index}
    return next(row for row in document["testing"] if wanted.items() <= row.items())


def summary(document: dict[str, Any]) -> list[tuple[str, Table]]:
    """For the terminal: table 2 beside the paper, and the three ranges."""
    rows = []
    for method in (RAW, *METHODS):
        line = [method]
        for index in INDICES:
            parts = [cell(document, scored_on, method, AXES[3], index) for scored_on in SCORED]
            printed = parts[0]["paper_deg"]
            line += [*(significant(part["median_deg"]) for part in parts), "" if printed is None else f"{printed:.3f}"]
        rows.append(tuple(line))
    columns = ("method", *(f"{i}{way}" for i in INDICES for way in (" fresh", " held out", " paper")))
    n, seeds = document["study"]["measured"], document["study"]["seeds"]
    second = Table(columns, tuple(rows))
    tables = [
        (f"table 2: volumetric error [deg], n = {n}, median over {seeds} seeds; fresh and noise-free, held out", second)
    ]
    for scored_on in SCORED:
        by = {(r["method"], r["range"]): r for r in document["ranges"] if _volumetric(r, scored_on)}
        labels = [r.label for r in RANGES if (METHODS[0], r.label) in by]
        lines = []
        for method in METHODS:
            line = [method]
            for label in labels:
                printed = by[method, label]["paper_deg"]
                line += [significant(by[method, label]["median_deg"]), "" if printed is None else f"{printed:.3f}"]
            lines.append(tuple(line))
        columns = ("method", *(part for label in labels for part in (label, "paper")))
        way = "fresh, noise-free" if scored_on == "fresh" else "held out, as the paper does"
        tables.append((f"mean volumetric error [deg] over three ranges of n, {way}", Table(columns, tuple(lines))))
    return tables


def _volumetric(row: dict[str, Any], scored_on: str) -> bool:
    return row["scored_on"] == scored_on and row["axis"] == AXES[3]


def page(made: Findings) -> str:
    from markupsafe import Markup

    from kincal.pipeline.report.figures import inline
    from kincal.pipeline.report.pages import environment

    templates = environment(Path(__file__).parent / "templates")
    templates.filters["significant"] = significant
    return templates.get_template("page.html").render(
        document=made.document,
        figures={name: Markup(inline(svg, name)) for name, svg in made.figures.items()},
        methods=(RAW, *METHODS),
        labels=LABELS,
        scored=SCORED,
        axes=AXES,
        indices=INDICES,
        cell=lambda *which: cell(made.document, *which),
        volumetric=_volumetric,
    )


def files(results: Reproduced, made: Findings) -> dict[str, bytes]:
    """{name: content} of the output folder. The same results give the same bytes."""
    return {
        **{f"{name}.svg": svg.encode() for name, svg in made.figures.items()},
        **{name: _csv(rows) for name, rows in made.tables.items()},
        "results.parquet": results.table.to_parquet(index=False),
        "results.json": (json.dumps(made.document, indent=1, allow_nan=False) + "\n").encode(),
        "index.html": page(made).encode(),
    }


def _csv(rows: list[Row]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def write(results: Reproduced, made: Findings, folder: Path) -> Path:
    """All files, the page last, each replaced at once. Returns the page. Raises InputError."""
    replace_files(folder, files(results, made), f"--output {folder}")
    return folder / "index.html"
