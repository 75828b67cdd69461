"""The figures of a reproduction, numbered as in the paper. SVG whose bytes depend on the results alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.report.figures import COLOURS, STYLE, clean, quartile_line, svg
from kincal.pipeline.report.paper import AXES, BP, RANGES, TESTING, TRANSFER
from kincal.pipeline.reproduce.claims import Claims
from kincal.pipeline.reproduce.study import Reproduced, Row
from kincal.pipeline.reproduce.tables import SCORED_ON, values

_ABOUT = {"x": "about x", "y": "about y", "z": "about z", "volumetric": "volumetric"}
_WIDTH = 10.5


def figures(
    results: Reproduced, figure_10: Sequence[Row], claims: list[Claims], pretraining: Sequence[Row]
) -> dict[str, str]:
    """{name: SVG}."""
    with rc_context(STYLE):
        return {
            "figure5": svg(_configurations_5(results)),
            "figure6": svg(_by_pose(results, training=True)),
            "figure7": svg(_by_pose(results, training=False)),
            "figure8": svg(_configurations_8(results)),
            "figure10": svg(_against_n(figure_10)),
            "advantage": svg(_advantage(claims)),
            "pretraining": svg(_pretraining(pretraining, results.study.prior)),
        }


def _configurations_5(results: Reproduced) -> Figure:
    figure = Figure(figsize=(_WIDTH, 4.6))
    source, _ = results.grids
    errors = results.pose_errors[0]
    trained = np.setdiff1d(np.arange(len(errors.configurations)), errors.tested)
    left = _space(figure, 121, f"(a) source task: {len(source)}")
    left.scatter(*source.T, s=3, color=COLOURS["geometric"], depthshade=False, lw=0)
    right = _space(figure, 122, f"(b) measured: {len(errors.configurations)}, seed 0's split")
    for rows, label, colour in ((trained, "training", "geometric"), (errors.tested, "testing", "hybrid")):
        right.scatter(*errors.configurations[rows].T, s=12, color=COLOURS[colour], depthshade=False, lw=0, label=label)
    figure.legend(loc="lower center", ncols=2, frameon=False)
    return figure


def _configurations_8(results: Reproduced) -> Figure:
    figure = Figure(figsize=(5.4, 4.6))
    _, target = results.grids
    axes = _space(figure, 111, f"{len(target)} configurations, of which n are drawn")
    axes.scatter(*target.T, s=10, color=COLOURS["geometric"], depthshade=False, lw=0)
    return figure


def _space(figure: Figure, place: int, title: str) -> Any:
    axes = figure.add_subplot(place, projection="3d")
    axes.set_title(title, fontsize=9)
    for axis in "xyz":
        getattr(axes, f"set_{axis}label")(f"{axis} [deg]")
    axes.set_box_aspect((1, 1, 0.7))
    return axes


def _by_pose(results: Reproduced, training: bool) -> Figure:
    """Errors configuration by configuration, as measured: network and transfer as points, the others as thin lines."""
    errors = results.pose_errors[0]
    each = errors.training if training else errors.testing
    figure = Figure(figsize=(_WIDTH, 6.2), layout="constrained")
    for k, axes in enumerate(figure.subplots(2, 2, sharex=True).flat):
        for name in METHODS:
            vector = each[errors.methods.index(name)]
            size = np.linalg.norm(vector, axis=1) if k == 3 else np.abs(vector[:, k])
            at = np.arange(1, len(size) + 1)
            if name in (BP, TRANSFER):
                axes.plot(at, size, "o-", ms=3, lw=0.9, color=COLOURS[name], label=name, zorder=3)
            else:
                axes.plot(at, size, lw=0.9, color=COLOURS[name], label=name, alpha=0.6)
        axes.set_yscale("log")
        axes.set_ylim(bottom=1e-5 if k < 3 else 1e-4)
        axes.set_title(f"({'abcd'[k]}) {_ABOUT[AXES[k]]}", fontsize=9, loc="left")
        axes.set_ylabel("error [deg]")
        clean(axes)
        if k > 1:
            axes.set_xlabel(f"{'training' if training else 'testing'} configuration")
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def _against_n(rows: Sequence[Row]) -> Figure:
    """One row a way of scoring, one column an axis; crosses: the paper's tables, a dashed line: its range's mean."""
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 4, sharex=True, sharey="row")
    for line, scored_on in zip(panels, SCORED_ON, strict=True):
        for k, (axes, axis) in enumerate(zip(line, AXES, strict=True)):
            part = [row for row in rows if row["scored_on"] == scored_on and row["axis"] == axis]
            _lines(axes, part, "n")
            _paper(axes, axis)
            axes.set_yscale("log")
            axes.set_title(f"({'abcd'[k]}) {_ABOUT[axis]}", fontsize=9, loc="left")
            clean(axes)
        line[0].set_ylabel(f"mean error [deg]\n{SCORED_ON[scored_on]}")
    for axes in panels[-1]:
        axes.set_xlabel("n, measured poses")
    handles = panels[0][3].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=8, frameon=False)
    return figure


def _paper(axes: Any, axis: str) -> None:
    for which in RANGES[1:]:
        axes.axvline(which.low - 5, color="#999", lw=0.8, ls=":")  # between the sizes, which are tens
    for name in METHODS:
        printed = TESTING.get((name, axis, "mean"))
        if printed is not None:
            axes.plot(150, printed, "x", ms=7, mew=1.8, color=COLOURS[name], zorder=4)
        for which in RANGES if axis == AXES[3] else ():
            if name in which.mean_deg:
                axes.hlines(which.mean_deg[name], which.low, which.high - 4, color=COLOURS[name], lw=1.6, ls="--")
    axes.plot([], [], "x", ms=7, mew=1.8, color="#333", label="paper, tables 1 and 2")
    axes.plot([], [], "--", lw=1.6, color="#333", label="paper, mean over a range")


def _lines(axes: Any, rows: Sequence[Row], x: str) -> None:
    """Median and quartiles over seeds, one line a method."""
    for name in METHODS:
        method_rows = [row for row in rows if row["method"] == name]
        if method_rows:
            quartile_line(axes, name, *(values(method_rows, key) for key in (x, "median_deg", "low_deg", "high_deg")))


def _advantage(claims: list[Claims]) -> Figure:
    """The BP network's error over the transfer network's against n; filled where it is shown not to be chance."""
    figure = Figure(figsize=(_WIDTH, 3.8), layout="constrained")
    colours = dict(zip(sorted({c.hidden for c in claims}), ("#2a9d8f", "#c98a00", "#7a3e9d", "#b3261e"), strict=False))
    for axes, scored_on in zip(figure.subplots(1, 2, sharey=True), SCORED_ON, strict=True):
        for c in (c for c in claims if c.scored_on == scored_on):
            colour = colours.get(c.hidden, "#333")
            n, ratio, low, high, p = np.array(
                [(s.n, s.compared.ratio, s.compared.low, s.compared.high, s.p_holm) for s in c.sizes]
            ).T
            axes.plot(n, ratio, "-", lw=1.2, color=colour, label=f"H = {c.hidden}")
            axes.fill_between(n, low, high, color=colour, alpha=0.15, lw=0)
            axes.scatter(n, ratio, s=16, color=np.where(p < 0.05, colour, "#ffffff"), edgecolor=colour, zorder=3)
        axes.axhline(1, color="#333", lw=0.8)
        axes.set_yscale("log")
        axes.set_title(SCORED_ON[scored_on], fontsize=9, loc="left")
        axes.set_xlabel("n, measured poses")
        axes.legend(frameon=False)
        clean(axes)
    figure.axes[0].set_ylabel("error of network / error of transfer")
    return figure


def _pretraining(rows: Sequence[Row], usual: int) -> Figure:
    figure = Figure(figsize=(_WIDTH, 3.8), layout="constrained")
    for axes, scored_on in zip(figure.subplots(1, 2, sharey=True), SCORED_ON, strict=True):
        _lines(axes, [row for row in rows if row["scored_on"] == scored_on], "prior_poses")
        axes.axvline(usual, color="#999", lw=0.8, ls=":")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_title(SCORED_ON[scored_on], fontsize=9, loc="left")
        axes.set_xlabel(f"poses of the source task (the paper's: {usual})")
        axes.legend(frameon=False)
        clean(axes)
    figure.axes[0].set_ylabel("mean error [deg]")
    return figure
