"""The paper's tables out of a reproduction: medians and quartiles over seeds, and the paper's number beside them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.report.paper import AXES, BEFORE, BP, INDICES, RANGES, TESTING, TRANSFER, Range, table_of
from kincal.pipeline.reproduce.paired import Paired, paired
from kincal.pipeline.reproduce.study import Reproduced, Row

SCORED_ON = {"fresh": "500 fresh poses, noise-free", "held_out": "20 % held out, as measured"}  # the paper's way last
_QUARTILES = (("median_deg", 0.5), ("low_deg", 0.25), ("high_deg", 0.75))


def column(scored_on: str, axis: str, index: str = "mean") -> str:
    """Of a job's row."""
    return f"{scored_on}_{axis if axis in 'xyz' else index}_deg"


def values(rows: Iterable[Row], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows], dtype=float)


def summed_up(errors: np.ndarray) -> dict[str, float]:
    """Median and quartiles of errors (seeds,)."""
    return {name: float(np.quantile(errors, share)) for name, share in _QUARTILES}


def testing(results: Reproduced) -> list[Row]:
    """Tables 1 and 2: one row a cell, for either way of scoring."""
    rows = []
    for scored_on in SCORED_ON:
        for k, method in enumerate(results.pose_errors[0].methods):
            each = [e.fresh[k] if scored_on == "fresh" else e.testing[k] for e in results.pose_errors]
            for axis in AXES:
                sizes = [np.abs(e[:, AXES.index(axis)]) if axis in "xyz" else np.linalg.norm(e, axis=1) for e in each]
                for index, statistic in zip(INDICES, (np.mean, np.max, np.std), strict=True):
                    row = {"table": table_of(axis), "scored_on": scored_on, "method": method, "axis": axis}
                    row |= {"index": index} | summed_up(np.array([statistic(size) for size in sizes]))
                    rows.append(row | {"paper_deg": TESTING.get((method, axis, index))})
    return rows


def after_compensation(results: Reproduced) -> dict[str, dict[str, float]]:
    """{method: median and quartiles} of the mean errors of commands made by each method, on the tables' robots."""
    rows = [row for row in results.rows if row["closed_loop_mean_deg"] is not None]
    by_method = {m: values((row for row in rows if row["method"] == m), "closed_loop_mean_deg") for m in METHODS}
    return {method: summed_up(errors) for method, errors in by_method.items() if len(errors)}


def studied(results: Reproduced, hidden: int, method: str) -> dict[int, list[Row]]:
    """{n: rows by seed} of the study of n."""
    place = {"planned_poses": results.study.drawn_from, "hidden": hidden, "method": method}
    by_size: dict[int, list[Row]] = {}
    for row in results.rows:
        if place.items() <= row.items():
            by_size.setdefault(row["n"], []).append(row)
    return {n: sorted(by_size[n], key=lambda row: row["seed"]) for n in sorted(by_size)}


def figure_10(results: Reproduced) -> list[Row]:
    """Mean errors against n: one row a size, method, axis and way of scoring."""
    found_rows = []
    for method in METHODS:
        for n, rows in studied(results, results.study.hidden, method).items():
            for scored_on in SCORED_ON:
                for axis in AXES:
                    row = {"n": n, "method": method, "scored_on": scored_on, "axis": axis}
                    found_rows.append(row | summed_up(values(rows, column(scored_on, axis))))
    return found_rows


def over_range(results: Reproduced, which: Range, scored_on: str, axis: str = AXES[3]) -> dict[str, np.ndarray]:
    """{method: (seeds,)} each seed's mean over the sizes in a range; empty where there are none."""
    name, means = column(scored_on, axis), {}
    for method in METHODS:
        sizes = studied(results, results.study.hidden, method).items()
        errors = [values(rows, name) for n, rows in sizes if which.low <= n <= which.high]
        if errors:
            means[method] = np.mean(errors, axis=0)
    return means


def ranges(results: Reproduced) -> list[Row]:
    """The paper's three ranges of n: one row a range, method, axis and way of scoring."""
    rows = []
    for which in RANGES:
        for scored_on in SCORED_ON:
            for axis in AXES:
                for method, errors in over_range(results, which, scored_on, axis).items():
                    row = {"range": which.label, "scored_on": scored_on, "method": method, "axis": axis}
                    row |= summed_up(errors)
                    printed = which.mean_deg.get(method) if axis == AXES[3] else None
                    noted = axis == AXES[3] and method in (BP, TRANSFER)
                    rows.append(row | {"paper_deg": printed, "paper_note": which.note if noted else ""})
    return rows


@dataclass(frozen=True)
class Choice:
    """Which method to take in a range of n: of the paper's two networks, and of all."""

    range: str
    scored_on: str
    paper: str  # its advice: neither, transfer or network
    of_two: str
    why: str
    best: str
    best_deg: float
    second: str
    over_second: Paired  # the second's error over the best's


def choices(results: Reproduced) -> list[Choice]:
    made = []
    for which in RANGES:
        for scored_on in SCORED_ON:
            errors = over_range(results, which, scored_on)
            if errors:
                made.append(_choice(which, scored_on, errors))
    return made


def _choice(which: Range, scored_on: str, errors: dict[str, np.ndarray]) -> Choice:
    """Of all: the lowest median. Of two: none that is worse than doing nothing; the simpler, unless transfer pays."""
    medians = {method: float(np.median(v)) for method, v in errors.items()}
    best, second = sorted(medians, key=lambda method: medians[method])[:2]
    compared = paired(errors[BP], errors[TRANSFER])
    usable = [method for method in (BP, TRANSFER) if medians[method] < medians[BEFORE]]
    if not usable:
        of_two, why = "neither", "both are worse than before calibration"
    elif len(usable) == 1:
        of_two, why = usable[0], "the other is worse than before calibration"
    elif compared.says > 0:
        of_two, why = TRANSFER, f"{compared.ratio:.2f} times better than the BP network, p = {compared.p:.2g}"
    elif compared.says < 0:
        of_two, why = BP, f"{1 / compared.ratio:.2f} times better than the transfer network, p = {compared.p:.2g}"
    else:
        of_two, why = BP, f"the simpler one: no difference is shown (p = {compared.p:.2g})"
    over = paired(errors[second], errors[best])
    return Choice(which.label, scored_on, which.choice, of_two, why, best, medians[best], second, over)
