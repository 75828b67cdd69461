"""Figures of an identification: singular values, what each parameter owes to data and prior, how far it moved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kincal.identification.identification import Identification
from kincal.pipeline.report.figures import BLUE, GREY, RED, STYLE, any_letters, clean, label
from kincal.pipeline.store.files import refusing
from kincal.urdf.errors import InputError

_FORMATS = (".svg", ".png", ".pdf")
_FLAGGED = 4  # tolerances


def draw(identification: Identification, file: Path, before: bool) -> None:
    """All figures on one page. Raises InputError for a format that is not known, or a file that can't be written."""
    if file.suffix.lower() not in _FORMATS:
        raise InputError(f"--plot {file}: allowed are {', '.join(_FORMATS)}")
    width = max(8.0, 2.0 + 0.11 * len(identification.names))
    with rc_context(STYLE):
        figure = Figure(figsize=(width, 6.2 if before else 8.6), layout="constrained")
        panels = figure.subplots(2 if before else 3, 1, gridspec_kw={"height_ratios": [1, 1] if before else [1, 1, 1]})
        singular_values(identification, panels[0])
        shares(identification, panels[1], names=before)
        if not before:
            changes(identification, panels[2])
        with refusing(f"--plot {file}"), any_letters():
            figure.savefig(file, dpi=130)


def singular_values(identification: Identification, axes: Any) -> None:
    values = np.maximum(identification.singular_values, identification.singular_values[0] * 1e-18)
    index = np.arange(1, len(values) + 1)
    axes.semilogy(
        index[: identification.rank],
        values[: identification.rank],
        "o",
        ms=3,
        color=BLUE,
        label=f"rank {identification.rank}",
    )
    axes.semilogy(
        index[identification.rank :], values[identification.rank :], "o", ms=3, color=GREY, label="unobservable"
    )
    axes.axhline(identification.rank_tolerance, color=RED, lw=1, label="tolerance")
    axes.set_xlabel("singular value of the identification Jacobian")
    axes.legend(frameon=False)
    clean(axes, "y")


def shares(identification: Identification, axes: Any, names: bool) -> None:
    """Of each parameter: seen by the data alone, and what the estimate owes to data rather than to its prior."""
    place = np.arange(len(identification.names))
    axes.bar(place, identification.observable_share, width=0.8, color=GREY, alpha=0.35, label="observable share")
    axes.bar(place, identification.data_share, width=0.4, color=BLUE, label="from data; the rest is the prior's")
    axes.set_ylim(0, 1.02)
    axes.set_xlim(-1, len(place))
    axes.set_ylabel("share")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(0, 1.22), ncols=2)
    _named(axes, identification.names if names else ())


def changes(identification: Identification, axes: Any) -> None:
    """Changes in tolerances with 95 % intervals; W and T, which have none, are left out."""
    place = np.flatnonzero(np.isfinite(identification.tolerance))
    moved, sigma = (
        identification.change[place] / identification.tolerance[place],
        identification.std[place] / identification.tolerance[place],
    )
    axes.errorbar(place, moved, 1.96 * sigma, fmt="o", ms=2.5, lw=0.8, color=BLUE, ecolor=GREY)
    far = np.abs(moved) > _FLAGGED
    axes.plot(place[far], moved[far], "o", ms=4, color=RED)
    for limit in (-_FLAGGED, _FLAGGED):
        axes.axhline(limit, color=RED, lw=0.8, ls="--")
    axes.set_xlim(-1, len(identification.names))
    axes.set_ylabel("change [tolerances]")
    _named(axes, identification.names)


def _named(axes: Any, names: tuple[str, ...]) -> None:
    shown = [label(name) for name in names]
    axes.set_xticks(np.arange(len(names)), shown, rotation=90, fontsize=5, parse_math=False)
    if not names:
        axes.tick_params(bottom=False)
    clean(axes, "y")
