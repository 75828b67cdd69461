"""What came of a fleet as one tidy table: scores by method, and which unit is out of family."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.report.numbers import fixed, significant
from kincal.pipeline.report.tables import Table
from kincal.pipeline.run.fan_out import Failure, Outcome
from kincal.pipeline.store.files import replace_files
from kincal.pipeline.store.manifest import Damaged
from kincal.pipeline.store.store import Store
from kincal.pipeline.studies.fleet import Fleet
from kincal.pipeline.studies.rows import METHOD_NUMBERS, UNITS, method_rows, records
from kincal.urdf.errors import CalibrationError

if TYPE_CHECKING:
    import pandas as pd

    from kincal.identification.family import Membership
    from kincal.identification.identification import Identification

_SHOWN = ("nominal", "geometric", "hybrid")  # methods
_FAMILY = {
    "spread": "Float64",
    "misfit": "Float64",
    "distance": "Float64",
    "probability": "Float64",
    "out_of_family": "boolean",
    "parameter": "string",
    "deviation": "Float64",
    "warnings": "string",
    "error": "string",
}


def fleet_table(fleet: Fleet) -> pd.DataFrame:
    """One row a robot and method, columns of one type each; one row a robot that failed."""
    import pandas as pd

    known, rows = _families(fleet), []
    for k, (member, outcome) in enumerate(zip(fleet.members, fleet.outcomes, strict=True)):
        columns = {"robot": member.name, "reference": member.reference}
        error = outcome.error if isinstance(outcome, Failure) else known[k].get("lost")
        if error is not None:
            rows.append(columns | {"error": str(error)})
        elif isinstance(outcome, Outcome) and outcome.comparison is not None:
            rows += [columns | row | known[k] for row in method_rows(outcome.comparison)]
    texts = ("robot", "reference", "method", "scored_on")
    kinds = dict.fromkeys(texts, "string") | {"n_poses": "Int64"} | dict.fromkeys(METHOD_NUMBERS, "Float64") | _FAMILY
    return pd.DataFrame({name: pd.Series([r.get(name) for r in rows], dtype=kind) for name, kind in kinds.items()})


def _families(fleet: Fleet) -> dict[int, dict[str, Any]]:
    """{member: what its identification says beside the others of its design}."""
    from kincal.identification.family import memberships

    by_member: dict[int, dict[str, Any]] = defaultdict(dict)
    designs: dict[tuple[Any, ...], list[tuple[int, Identification]]] = defaultdict(list)
    for k, outcome in enumerate(fleet.outcomes):
        if isinstance(outcome, Failure):
            continue
        try:
            identified = _identification(Store(fleet.members[k].job.store), outcome)
        except Damaged as damage:
            by_member[k]["lost"] = CalibrationError(f"{damage}: run it again")
            continue
        designs[identified.names, identified.tolerance.tobytes()].append((k, identified))
    for units in designs.values():
        for (k, unit), membership in zip(units, memberships([unit for _, unit in units]), strict=True):
            by_member[k] = _described(unit, membership)
    return by_member


def _identification(store: Store, outcome: Outcome) -> Identification:
    from kincal.pipeline.results import Identified

    key = next(passed.key for passed in outcome.passed if passed.stage == "identify")
    entry = store.find("identify", key)
    if entry is None:
        raise Damaged(f"identify {key[:12]}: its artifact is gone", store.root, None)
    return store.load(entry, Identified).shipped


def _described(unit: Identification, membership: Membership) -> dict[str, Any]:
    warnings = [*unit.findings, *(f"pose {outlier.pose}: {outlier.reason}" for outlier in unit.outliers)]
    return {
        "spread": membership.spread,
        "misfit": unit.chi_square / unit.degrees_of_freedom if unit.degrees_of_freedom > 0 else None,
        "distance": membership.distance,
        "probability": membership.probability,
        "out_of_family": membership.out_of_family,
        "parameter": membership.parameter,
        "deviation": membership.deviation,
        "warnings": "; ".join(warnings) or None,
    }


def shown_table(table: pd.DataFrame) -> Table:
    """One row a robot, for people."""
    units = [unit for unit in UNITS if any(table[unit].notna())]
    rows = []
    for robot in _by_robot(table):
        scores = {row["method"]: row for row in robot}
        cells = [robot[0]["robot"], "" if robot[0]["n_poses"] is None else str(robot[0]["n_poses"])]
        for unit in units:
            cells += [significant(scores.get(method, {}).get(unit)) for method in _SHOWN]
            cells.append(significant(scores.get("hybrid", {}).get(unit.replace("mean", "max"))))
        cells += [fixed(robot[0][name], 2) for name in ("spread", "misfit", "distance")]
        rows.append((*cells, _remark(robot[0])))
    columns = ["robot", "poses"]
    for unit in units:
        columns += [f"{name} [{UNITS[unit]}]" for name in (*_SHOWN, "hybrid max")]
    return Table((*columns, "spread", "misfit", "distance", "remark"), tuple(rows))


def _remark(row: Mapping[str, Any]) -> str:
    if row["error"] is not None:
        return "failed: " + " ".join(row["error"].split())
    n = 0 if row["warnings"] is None else row["warnings"].count("; ") + 1
    remarks = [f"{n} warning{'s' * (n > 1)}"] if n else []
    if row["out_of_family"] is True:
        worst = f": {row['parameter']} is {row['deviation']:+.1f} sigmas off" if row["parameter"] else ""
        remarks.insert(0, f"OUT OF FAMILY{worst}")
    return ", ".join(remarks)


def _by_robot(table: pd.DataFrame) -> list[list[dict[str, Any]]]:
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in records(table):
        rows[row["reference"]].append(row)
    return list(rows.values())


def family_lines(table: pd.DataFrame) -> list[str]:
    """What the columns mean, where a family was judged."""
    from kincal.identification.family import FALSE_ALARM, FEWEST

    judged = [robot[0]["out_of_family"] for robot in _by_robot(table) if robot[0]["out_of_family"] is not None]
    if not judged:
        return []
    n = sum(judged)
    return [
        f"{n} of {len(judged)} units out of family (designs of {FEWEST} units or more are judged; where all are alike, "
        f"one is named in about {100 * FALSE_ALARM:g} % of such fleets: docs/how-to/fleet.md)"
    ]


def _counts(fleet: Fleet) -> dict[str, Any]:
    failed = sum(isinstance(outcome, Failure) for outcome in fleet.outcomes)
    return {"fleet": fleet.name, "robots": len(fleet.members), "failed": failed}


def _provenance(fleet: Fleet) -> dict[str, Any]:
    """{reference: of its results}"""
    pairs = zip(fleet.members, fleet.outcomes, strict=True)
    return {member.reference: outcome.provenance for member, outcome in pairs if isinstance(outcome, Outcome)}


def fleet_json(fleet: Fleet, table: pd.DataFrame, file: Path | None) -> dict[str, Any]:
    """The document of `--json`."""
    return _counts(fleet) | {
        "out_of_family": sorted(set(table["robot"][table["out_of_family"].fillna(False)])),
        "table": None if file is None else str(file),
        "rows": records(table),
        "provenance": _provenance(fleet),
    }


def stage_frame(fleet: Fleet) -> pd.DataFrame:
    """One row a robot: robot, reference, state, error."""
    import pandas as pd

    return pd.DataFrame(_stage_rows(fleet))


def stage_json(fleet: Fleet, until: str) -> dict[str, Any]:
    """The document of `--json` where not all stages were asked for."""
    return _counts(fleet) | {"stage": until, "rows": _stage_rows(fleet), "provenance": _provenance(fleet)}


def _stage_rows(fleet: Fleet) -> list[dict[str, Any]]:
    rows = []
    for member, outcome in zip(fleet.members, fleet.outcomes, strict=True):
        failed = isinstance(outcome, Failure)
        state, error = (None, str(outcome.error)) if failed else (outcome.passed[-1].state, None)
        rows.append({"robot": member.name, "reference": member.reference, "state": state, "error": error})
    return rows


class _Shared(dict[str, Any]):
    """Attributes of a table that pandas would copy, to the depth, at each look at a column."""

    def __deepcopy__(self, memo: dict[int, Any]) -> _Shared:
        return self


def write_table(fleet: Fleet, table: pd.DataFrame, folder: Path) -> Path:
    """fleet.parquet, with the robots' provenance; what stood there is replaced at once. Raises InputError."""
    file, written = folder / "fleet.parquet", table.copy(deep=False)
    # Without the command: the same results give the same bytes.
    written.attrs["provenance"] = _Shared(
        (name, {key: value for key, value in document.items() if key != "command"})
        for name, document in _provenance(fleet).items()
    )
    replace_files(folder, {file.name: written.to_parquet(index=False)}, f"fleet table {file}")
    return file


def stage_table(fleet: Fleet, until: str) -> Table:
    """Where not all stages were asked for: one row a robot."""
    rows = tuple((row["robot"], row["state"] or f"failed: {row['error']}") for row in _stage_rows(fleet))
    return Table(("robot", until), rows)
