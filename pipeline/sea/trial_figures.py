"""The figures of a sea trial; 13 to 15 as numbered in the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kincal.pipeline.report.figures import COLOURS, GREY, STYLE, clean, svg
from kincal.pipeline.results import RAW
from kincal.pipeline.sea.configurations import Configurations
from kincal.pipeline.sea.trial import SeaTrial

_DRAWN = ("nominal", "network", "transfer", "hybrid")  # in figures 13 and 14: the paper's three, and ours
_ABOUT = ("about x", "about y", "about z", "volumetric")
_MOST = 3000  # points of a curve: more can't be seen


def figures(trial: SeaTrial, poses: Configurations) -> dict[str, str]:
    """{name: SVG}."""
    training = np.setdiff1d(np.arange(len(poses.desired)), poses.test)
    with rc_context(STYLE):
        return {
            "ship": svg(_ship(trial)),
            "deck": svg(_deck(trial)),
            "figure13": svg(_by_configuration(poses, training, trial.full)),
            "figure14": svg(_by_configuration(poses, poses.test, trial.full)),
            "figure15": svg(_in_space(poses)),
        }


def _ship(trial: SeaTrial) -> Figure:
    """The ship's roll and pitch, and the filter's error."""
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    few = slice(None, None, max(1, len(trial.t) // _MOST))
    for k, (name, colour) in enumerate((("roll", COLOURS["geometric"]), ("pitch", COLOURS["hybrid"]))):
        above.plot(trial.t[few], np.rad2deg(trial.ship[few, k]), lw=0.9, color=colour, label=name)
        below.plot(
            trial.t[few], np.rad2deg(trial.filtered - trial.ship[:, :2])[few, k], lw=0.9, color=colour, label=name
        )
    above.set_ylabel("ship [deg]")
    below.set_ylabel("filter's error [deg]")
    below.set_xlabel("time [s]")
    for axes in (above, below):
        clean(axes)
    above.legend(frameon=False, ncols=2, loc="upper right")
    return figure


def _deck(trial: SeaTrial) -> Figure:
    """The deck's volumetric error at sea, and what calibration alone leaves; means of a second."""
    figure = Figure(figsize=(10.5, 5.2), layout="constrained")
    at_sea, in_port = figure.subplots(2, 1, sharex=True)
    for sailed in trial.methods:
        colour, line = (GREY, ":") if sailed.name == RAW else (COLOURS[sailed.name], "-")
        for axes, error in ((at_sea, sailed.error), (in_port, sailed.calibration)):
            second = max(1, round(len(error) * trial.rate_hz / len(trial.t)))
            rows = len(error) // second * second
            size = np.rad2deg(np.linalg.norm(error[:rows], axis=1)).reshape(-1, second).mean(axis=1)
            axes.semilogy(np.arange(len(size)) + 0.5, size, line, lw=1, color=colour, label=sailed.name)
    at_sea.set_title("at sea", fontsize=9)
    in_port.set_title("calibration alone: perfect sensors and actuators, the load of the port", fontsize=9)
    for axes in (at_sea, in_port):
        clean(axes)
        axes.set_ylabel("deck error [deg]")
    in_port.set_xlabel("time [s]")
    figure.legend(*at_sea.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _by_configuration(poses: Configurations, rows: np.ndarray, full: bool) -> Figure:
    figure = Figure(figsize=(10.5, 5.0), layout="constrained")
    for k, axes in enumerate(figure.subplots(2, 2, sharex=True).ravel()):
        for name in (n for n in _DRAWN if n in poses.errors):
            error = np.rad2deg(poses.errors[name][rows])
            values = np.linalg.norm(error, axis=1) if k == 3 else np.abs(error[:, k])
            if k != 2 or full:
                axes.semilogy(np.arange(1, len(rows) + 1), values, lw=0.9, color=COLOURS[name], label=name)
        clean(axes)
        axes.set_title(f"({'abcd'[k]}) {_ABOUT[k]}" + ("" if k != 2 or full else ": not measured"), fontsize=9)
        axes.set_ylabel("error [deg]")
        if k > 1:
            axes.set_xlabel("configuration")
        if not k:
            figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _in_space(poses: Configurations) -> Figure:
    """Volumetric errors over all configurations, before and after."""
    from kincal.urdf.rigid_motion import xyz_angles

    figure = Figure(figsize=(10.5, 3.9))
    at = np.rad2deg(xyz_angles(poses.desired))
    for place, (name, title) in enumerate(
        (("nominal", "(a) before calibration"), ("transfer", "(b) transfer"), ("hybrid", "(c) hybrid")), 1
    ):
        axes: Any = figure.add_subplot(1, 3, place, projection="3d")
        size = np.rad2deg(np.linalg.norm(poses.errors[name], axis=1))
        shown = axes.scatter(*at.T, c=size, s=12, cmap="viridis", depthshade=False, lw=0)
        axes.set_title(title, fontsize=9)
        for axis in "xyz":
            getattr(axes, f"set_{axis}label")(f"{axis} [deg]", fontsize=7, labelpad=-6)
        axes.tick_params(labelsize=6, pad=-3)
        bar = figure.colorbar(shown, ax=axes, shrink=0.6, pad=0.12)
        bar.ax.tick_params(labelsize=7)
        bar.set_label("error [deg]", fontsize=7)
    figure.subplots_adjust(left=0.02, right=0.96, wspace=0.25)
    return figure
