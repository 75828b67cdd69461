"""Which poses an operator should measure, how good they are beside other layouts, and how many are needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from kincal.identification.d_optimal import candidates, check_count, d_optimal
from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import Sites, all_feasible, information, of_one_row, prior_sigma
from kincal.identification.identifiability import identifiability
from kincal.identification.observability import Observability, observability
from kincal.identification.poses import planned
from kincal.identification.predicted_accuracy import PredictedAccuracy, Probe
from kincal.identification.registration import MIN_POSES
from kincal.pipeline.report.numbers import fixed
from kincal.pipeline.report.tables import Table
from kincal.pipeline.store.files import refusing, replace_file
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Layout, Plan, RobotDescription, Sensor, Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.workspace import AXES, sample

LAYOUTS: tuple[Layout, ...] = get_args(Layout)
MOST = 500  # poses that a search goes up to
_FRESH = 500  # poses at which the accuracy is predicted
_REFERENCE = 200  # poses that show all that this robot's poses can show


@dataclass(frozen=True)
class Wanted:
    """A predicted mean error to reach; None: no demand."""

    deg: float | None = None
    mm: float | None = None

    def met(self, accuracy: PredictedAccuracy) -> bool:
        pairs = ((self.deg, accuracy.mean_deg), (self.mm, accuracy.mean_mm))
        return all(wanted is None or (mean is not None and mean <= wanted) for wanted, mean in pairs)

    def __str__(self) -> str:
        parts = [f"{self.deg:g} deg" if self.deg else "", f"{self.mm:g} mm" if self.mm else ""]
        return " and ".join(part for part in parts if part)


@dataclass(frozen=True)
class LayoutScore:
    """What n poses of one layout are worth."""

    layout: Layout
    n_poses: int
    observability: Observability
    accuracy: PredictedAccuracy


@dataclass(frozen=True)
class PlanReport:
    """The poses, and the layouts side by side at the same number of poses."""

    robot: str
    layout: Layout
    channels: tuple[str, ...]
    table: pd.DataFrame
    scores: tuple[LayoutScore, ...]
    wanted: Wanted | None
    needed: Mapping[Layout, int | None]  # poses for what is wanted; None: not within MOST

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the poses, a sentence each."""
        seen = {score.layout: score.observability for score in self.scores}
        own = seen[self.layout]
        if own.excited >= own.excitable:
            return ()
        others = [name for name, o in seen.items() if o.excited == o.excitable]
        instead = f", or layout {' or '.join(others)}," if others else ""
        return (
            f"these {len(self.table)} poses leave {own.excitable - own.excited} of {own.excitable} directions of the "
            f"parameters unexcited. More poses{instead} determine them",
        )


@dataclass(frozen=True)
class Planner:
    """One robot as drawn, what is measured of it, and how well."""

    model: ErrorModel
    workspace: Workspace
    channels: tuple[str, ...]
    sensor: Sensor  # of one row
    seed: int
    _known: dict[tuple[Layout, int], tuple[Sites, np.ndarray]] = field(default_factory=dict, repr=False, compare=False)

    def sites(self, layout: Layout, n: int) -> Sites:
        """n poses of a layout: those that the plan stage of the pipeline has. Raises InputError."""
        return self._of(layout, n)[0]

    def _of(self, layout: Layout, n: int) -> tuple[Sites, np.ndarray]:
        """The poses, and the information in each."""
        if (layout, n) not in self._known:
            sites = self._planned(layout, n)
            self._known[layout, n] = (sites, information(self.model, sites, self.channels, self.sensor))
        return self._known[layout, n]

    def _planned(self, layout: Layout, n: int) -> Sites:
        if layout == "d_optimal":
            return d_optimal(self.model, self.workspace, self.channels, self.sensor, n, self.seed)
        u = planned(self.workspace, self.model.chain.tool_axes, Plan(poses=n, layout=layout), self.seed)
        return all_feasible(self.model, self.workspace, u, f"plan, layout {layout}")

    def accuracy(self, layout: Layout, n: int) -> PredictedAccuracy:
        return self.probe.accuracy(self._of(layout, n)[1])

    def score(self, layout: Layout, n: int) -> LayoutScore:
        parameters = self.model.parameters
        jacobian = self._of(layout, n)[1] / prior_sigma(parameters)
        return LayoutScore(layout, n, observability(jacobian, parameters, self.rank), self.accuracy(layout, n))

    def needed(self, layout: Layout, met: Callable[[PredictedAccuracy], bool], most: int) -> int | None:
        """How many poses of a layout meet a demand, by doubling and bisection; None: not within `most`."""
        fewer, n = MIN_POSES - 1, MIN_POSES
        while not met(self.accuracy(layout, n)):
            if n == most:
                return None
            fewer, n = n, min(2 * n, most)
        while n - fewer > 1:
            middle = (fewer + n) // 2
            fewer, n = (fewer, middle) if met(self.accuracy(layout, middle)) else (middle, n)
        return n

    @cached_property
    def probe(self) -> Probe:
        u = sample(self.workspace, self.model.chain.tool_axes, _FRESH, [self.seed, 13])
        return Probe.of(self.model, all_feasible(self.model, self.workspace, u, "plan, fresh poses"), self.channels)

    @cached_property
    def rank(self) -> int:
        """How many directions this robot's poses can show at all."""
        enough = max(_REFERENCE, len(self.model.parameters))
        sites = candidates(self.model, self.workspace, MIN_POSES, self.seed)[:enough]
        blocks = information(self.model, sites, self.channels, self.sensor) / prior_sigma(self.model.parameters)
        return identifiability(blocks.reshape(-1, blocks.shape[-1]), self.model.parameters).rank


def planner(description: RobotDescription, chain: ClosedChain) -> Planner:
    """Of a robot as its model stage has it."""
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    channels, sensor = of_one_row(description.planned_instruments, chain.tool_axes)
    return Planner(errors, description.workspace, channels, sensor, description.seed)


def plan_report(
    description: RobotDescription, chain: ClosedChain, layout: Layout | None, poses: int | None, wanted: Wanted | None
) -> PlanReport:
    """The plan of `kincal plan`.

    layout: default that of robot.toml, else d_optimal. poses: default as many as are wanted, else those of robot.toml.
    """
    chosen = layout or description.plan.layout or "d_optimal"
    if poses is not None:
        check_count(poses)
    for option, value in (("--accuracy", wanted and wanted.deg), ("--accuracy-mm", wanted and wanted.mm)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{option} {value:g}: allowed are numbers greater than 0")
    plan = planner(description, chain)
    needed: dict[Layout, int | None] = {}
    if wanted is not None:
        _check_measured(wanted, plan.probe)
        needed = {known: plan.needed(known, wanted.met, MOST) for known in LAYOUTS}
        if poses is None and needed[chosen] is None:
            raise InputError(
                f"plan: {wanted} can't be reached with {MOST} poses of layout {chosen}, which predict "
                f"{_said(plan.accuracy(chosen, MOST))}; better sensors help"
            )
    n = poses or needed.get(chosen) or description.plan.poses
    check_count(n)
    scores = tuple(plan.score(known, n) for known in LAYOUTS)
    table = operators_table(plan.model, plan.sites(chosen, n))
    return PlanReport(description.name, chosen, plan.channels, table, scores, wanted, needed)


def _check_measured(wanted: Wanted, probe: Probe) -> None:
    for option, value, quantity, seen in (
        ("--accuracy", wanted.deg, "orientation", probe.turned),
        ("--accuracy-mm", wanted.mm, "position", probe.moved),
    ):
        if value is not None and seen is None:
            raise InputError(f"{option}: {quantity} is not measured; see measure.channels")


def _said(accuracy: PredictedAccuracy) -> str:
    parts = [] if accuracy.mean_deg is None else [f"{accuracy.mean_deg:.3g} deg"]
    return " and ".join(parts + ([] if accuracy.mean_mm is None else [f"{accuracy.mean_mm:.3g} mm"]))


def operators_table(model: ErrorModel, sites: Sites) -> pd.DataFrame:
    """One row a pose, in an order in which the machine travels little: readings, and tool coordinates [mm, deg].

    A measurement table once what was measured stands beside them.
    """
    chain = model.chain
    sites = sites.in_travel_order(chain)
    columns = dict(zip(chain.actuated_names, sites.readings.round(9).T, strict=True))
    for axis in chain.tool_axes:
        unit, factor = ("mm", 1e3) if axis < 3 else ("deg", 180 / np.pi)
        columns[f"planned_{AXES[axis]}_{unit}"] = (factor * sites.u[:, axis]).round(6) + 0.0
    return pd.DataFrame({"pose": np.arange(len(sites)), **columns})


def check_output(file: Path, force: bool) -> None:
    """Refuse a file that can't be a plan, or that stands there already: an operator may have measured into it."""
    if file.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"--output {file}: allowed are .csv and .parquet")
    if file.exists() and not force:
        raise InputError(f"--output {file}: exists already; give another name, or --force")


def write_table(table: pd.DataFrame, file: Path) -> None:
    """A .csv or .parquet file. Raises InputError."""
    content = table.to_csv(index=False).encode() if file.suffix.lower() == ".csv" else table.to_parquet(index=False)
    with refusing(f"--output {file}"):
        replace_file(file, content)


def layout_table(scores: tuple[LayoutScore, ...]) -> Table:
    """The layouts side by side; what was not measured has no column."""
    first = scores[0].accuracy
    shown = [name for name in _ACCURACY if getattr(first, name) is not None]
    columns = ("layout", "excited", "O1", "O2", "O3", "O4", "O5", "condition", *(_ACCURACY[n][0] for n in shown))
    rows = []
    for score in scores:
        seen = score.observability
        cells = [f"{seen.excited} of {seen.excitable}"]
        cells += [f"{v:.3g}" for v in (seen.o1, seen.o2, seen.o3, seen.o4, seen.o5, seen.condition_number)]
        cells += [fixed(getattr(score.accuracy, name), _ACCURACY[name][1]) for name in shown]
        rows.append((score.layout, *cells))
    return Table(columns, tuple(rows))


_ACCURACY = {
    "mean_deg": ("mean [deg]", 5),
    "rms_deg": ("rms [deg]", 5),
    "max_deg": ("max [deg]", 5),
    "mean_mm": ("mean [mm]", 4),
    "rms_mm": ("rms [mm]", 4),
    "max_mm": ("max [mm]", 4),
}


def needed_table(report: PlanReport) -> Table:
    rows = ((name, f"more than {MOST}" if n is None else str(n)) for name, n in report.needed.items())
    return Table(("layout", "poses"), tuple(rows))


def plan_json(report: PlanReport) -> dict[str, Any]:
    """The document of `plan --json`; null: not measured, not reached, or a condition number that is infinite."""
    layouts = []
    for score in report.scores:
        condition = score.observability.condition_number
        layouts.append(
            {"layout": score.layout, "n_poses": score.n_poses, **asdict(score.observability)}
            | {"condition_number": condition if np.isfinite(condition) else None, **asdict(score.accuracy)}
        )
    wanted = report.wanted
    return {
        "robot": report.robot,
        "layout": report.layout,
        "n_poses": len(report.table),
        "warnings": list(report.warnings),
        "channels": list(report.channels),
        "layouts": layouts,
        "wanted": None if wanted is None else {"mean_deg": wanted.deg, "mean_mm": wanted.mm, "most": MOST},
        "needed": None if wanted is None else dict(report.needed),
        "poses": report.table.to_dict(orient="records"),
    }
