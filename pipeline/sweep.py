"""`kincal sweep`: one robot over a grid of settings and seeds, as one tidy table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.executor import Place, executor
from pipeline.fan_out import Failure, Job, Observe, Outcome, files_of, portable, run_all
from pipeline.grid import Over, combinations, parse_over
from pipeline.results import Comparison
from pipeline.tables import Table, fixed
from pipeline.writing import refusing, replace_file
from urdf.description import RobotDescription
from urdf.errors import CalibrationError, InputError
from urdf.fleet import as_reference, load

if TYPE_CHECKING:
    import pandas as pd

MOST_SEEDS = 10_000
_NUMBERS = ("mean_deg", "max_deg", "sd_deg", "x_deg", "y_deg", "z_deg", "mean_mm", "max_mm", "sd_mm")
_MORE = ("closed_loop_mean_deg", "closed_loop_mean_mm", "held_out_mean_deg", "held_out_mean_mm")
METHOD_NUMBERS = (*_NUMBERS, *_MORE)
_DIGITS = {"mean_deg": 5, "mean_mm": 4}
UNITS = {"mean_deg": "deg", "mean_mm": "mm"}


@dataclass(frozen=True)
class Point:
    """One job of the sweep: the values of the swept keys, and the robot that they make."""

    values: Mapping[str, Any]
    job: Job
    robot: RobotDescription | InputError


@dataclass(frozen=True)
class Swept:
    """What came of a sweep."""

    robot: str
    overs: tuple[Over, ...]
    table: pd.DataFrame  # one row a job and method; one row a job that failed
    failures: tuple[tuple[Point, InputError | CalibrationError], ...]
    n_jobs: int

    @property
    def keys(self) -> list[str]:
        """Of the grid, the seed aside: results are summed up over it."""
        return [over.key for over in self.overs if over.key != "seed"]

    def check(self) -> None:
        """Raises InputError where all jobs were bad input, CalibrationError where any failed otherwise."""
        if not self.failures:
            return
        point, error = self.failures[0]
        where = ", ".join(f"{key}={value}" for key, value in point.values.items())
        said = f"{len(self.failures)} of {self.n_jobs} jobs failed, the first ({where}): {error}"
        bad = all(isinstance(error, InputError) for _, error in self.failures)
        raise (InputError if bad and len(self.failures) == self.n_jobs else CalibrationError)(said)


def plan_sweep(
    robot: str, over: Sequence[str], seeds: int, overrides: Sequence[str], store: Path, command: str = ""
) -> tuple[tuple[Over, ...], list[Point]]:
    """The grid and its jobs. Raises InputError, also where no job has a valid robot."""
    if not 1 <= seeds <= MOST_SEEDS:
        raise InputError(f"--seeds {seeds}: allowed are 1 (the robot's own) to {MOST_SEEDS}")
    overs = tuple(parse_over(text) for text in over)
    if seeds > 1:
        overs = (*overs, Over("seed", tuple(map(str, range(seeds)))))
    if not overs:
        raise InputError("nothing to sweep: give --over table.key=value,value,... or --seeds of 2 or more")
    load(robot, overrides)
    reference, shared = as_reference(robot), portable(overrides)
    points = []
    for places in combinations(overs):
        own = tuple(o.overrides()[k] for o, k in zip(overs, places, strict=True))
        values = {o.key: o.values[k] for o, k in zip(overs, places, strict=True)}
        job = Job(reference, (*shared, *portable(own)), store.absolute(), "evaluate", command)
        points.append(Point(values, job, _loaded(job, own)))
    bad = next((p.robot for p in points if isinstance(p.robot, InputError)), None)
    if bad is not None and all(isinstance(p.robot, InputError) for p in points):
        raise bad
    return overs, points


def _loaded(job: Job, own: Sequence[str]) -> RobotDescription | InputError:
    try:
        return load(job.robot, job.overrides).description
    except InputError as error:
        said = str(error)
        for override in own:  # as it was written
            said = said.replace(f"--set {override}", f"--over {override}")
        return InputError(said)


def sweep(overs: tuple[Over, ...], points: Sequence[Point], on: Place, observe: Observe) -> Swept:
    """All jobs, on these workers. A job that fails is a row; what is neither bad input nor a failed check is raised."""
    valid = [(point, point.robot) for point in points if isinstance(point.robot, RobotDescription)]
    jobs, robots = [point.job for point, _ in valid], [robot for _, robot in valid]
    with executor(on, jobs[0].store, files_of(jobs, robots)) as workers:
        came = run_all(jobs, robots, workers, observe)
    outcomes = {id(point): outcome for (point, _), outcome in zip(valid, came, strict=True)}
    rows, failures = [], []
    for point in points:
        outcome = Failure(point.robot) if isinstance(point.robot, InputError) else outcomes[id(point)]
        if isinstance(outcome, Failure):
            failures.append((point, outcome.error))
        rows += _rows(point, outcome)
    name = valid[0][1].name
    return Swept(name, overs, _frame(name, overs, rows), tuple(failures), len(points))


def _rows(point: Point, outcome: Outcome | Failure) -> list[dict[str, Any]]:
    seed = point.robot.seed if isinstance(point.robot, RobotDescription) else None
    own = {"seed": seed} | dict(point.values)
    if isinstance(outcome, Failure):
        return [own | {"error": str(outcome.error)}]
    assert outcome.comparison is not None
    return [own | row for row in method_rows(outcome.comparison)]


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


def _frame(robot: str, overs: Sequence[Over], rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Columns of one type each, whatever failed: the same sweep gives the same bytes."""
    import pandas as pd

    table = pd.DataFrame({"robot": [robot] * len(rows)})
    texts = {over.key: dict(zip(map(repr, over.values), over.texts, strict=True)) for over in overs}
    for key in ("seed", *(over.key for over in overs if over.key != "seed")):
        values = [row[key] for row in rows]
        if all(isinstance(v, int) and not isinstance(v, bool) for v in values if v is not None):
            table[key] = pd.array(values, dtype="Int64")
        elif all(isinstance(v, int | float) and not isinstance(v, bool) for v in values if v is not None):
            table[key] = pd.array(values, dtype="Float64")
        elif all(isinstance(v, bool | None) for v in values):
            table[key] = pd.array(values, dtype="boolean")
        else:  # strings, and lists or tables as they were written
            table[key] = pd.array([v if isinstance(v, str) else texts[key][repr(v)] for v in values], dtype="string")
    for column in ("method", "scored_on"):
        table[column] = pd.array([row.get(column) for row in rows], dtype="string")
    table["n_poses"] = pd.array([row.get("n_poses") for row in rows], dtype="Int64")
    for column in METHOD_NUMBERS:
        table[column] = pd.array([row.get(column) for row in rows], dtype="Float64")
    table["error"] = pd.array([row.get("error") for row in rows], dtype="string")
    return table


def medians(swept: Swept) -> pd.DataFrame:
    """One row a combination of swept values and method: jobs, median and quartiles of the mean errors over seeds."""
    import pandas as pd

    table = swept.table[swept.table["method"].notna()]
    groups = table.groupby([*swept.keys, "method"], sort=False)
    columns = {"jobs": groups["seed"].size()}
    for mean in UNITS:
        for name, share in ((mean, 0.5), (f"{mean}_low", 0.25), (f"{mean}_high", 0.75)):
            columns[name] = groups[mean].quantile(share)
    return pd.DataFrame(columns).reset_index()


def measured_units(found: pd.DataFrame) -> list[str]:
    """mean_deg, mean_mm: those that `medians` has numbers of."""
    return [mean for mean in UNITS if any(found[mean].notna())]


def median_tables(swept: Swept) -> list[tuple[str, Table]]:
    """For people: one row a combination of swept values, one column a method; what was not measured has no table."""
    found = medians(swept)
    methods = list(dict.fromkeys(found["method"]))
    n = len(set(swept.table["seed"][swept.table["method"].notna()]))
    tables = []
    for mean in measured_units(found):
        rows: dict[tuple[str, ...], dict[str, str]] = {}
        for row in records(found):
            label = tuple(str(row[key]) for key in swept.keys) or (swept.robot,)
            cells = rows.setdefault(label, {"jobs": str(row["jobs"])})
            cells[row["method"]] = fixed(row[mean], _DIGITS[mean])
        columns = (*(swept.keys or ["robot"]), "jobs", *methods)
        lines = tuple((*label, cells["jobs"], *(cells.get(m, "") for m in methods)) for label, cells in rows.items())
        title = f"median over {n} seed{'s' * (n > 1)} of the mean error [{UNITS[mean]}]"
        tables.append((title, Table(columns, lines)))
    return tables


def sweep_json(swept: Swept, table: Path, figure: Path | None) -> dict[str, Any]:
    """The document of `sweep --json`."""
    return {
        "robot": swept.robot,
        "over": {over.key: list(over.values) for over in swept.overs},
        "jobs": swept.n_jobs,
        "failed": len(swept.failures),
        "table": str(table),
        "figure": None if figure is None else str(figure),
        "medians": records(medians(swept)),
        "rows": records(swept.table),
    }


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of plain values, None where there is none."""
    columns = {str(name): zip(c.tolist(), c.isna(), strict=True) for name, c in table.items()}
    plain = {name: [None if empty else v for v, empty in cells] for name, cells in columns.items()}
    return [dict(zip(plain, row, strict=True)) for row in zip(*plain.values(), strict=True)]


def output_folder(output: Path | None, default: Path) -> Path:
    """Where the results go; tried before hours of work. Raises InputError."""
    folder = default if output is None else output
    with refusing(f"{'store' if output is None else '--output'} {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / ".sweep", b"")
        (folder / ".sweep").unlink(missing_ok=True)
    return folder.absolute()


def write(swept: Swept, folder: Path) -> tuple[Path, Path | None]:
    """sweep.parquet, and sweep.svg where a number was swept; what stood there is replaced at once."""
    over = next((o for o in swept.overs if o.numeric and o.key != "seed" and len(o.texts) > 1), None)
    drawn = None
    if over is not None and any(swept.table["method"].notna()):
        from pipeline.sweep_figure import drawing

        drawn = drawing(swept, over.key)
    table, figure = folder / "sweep.parquet", folder / "sweep.svg"
    with refusing(f"--output {folder}"):
        replace_file(table, swept.table.to_parquet(index=False))
        if drawn is not None:
            replace_file(figure, drawn.encode())
        else:
            figure.unlink(missing_ok=True)  # of an earlier sweep
    return table, figure if drawn is not None else None
