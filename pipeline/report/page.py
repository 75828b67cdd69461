"""The page to sign: self-contained HTML by jinja2, figures as inline SVG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from kincal.identification.channels import BY_ROWS
from kincal.identification.identification import Identification
from kincal.pipeline.learned import Fits, Learned, Pretrained, SiblingResiduals
from kincal.pipeline.report.figures import BLUE, GREY, RED, STYLE, clean, inline, svg
from kincal.pipeline.report.identification_figures import changes, singular_values
from kincal.pipeline.report.inspection import direction_lines, finding_lines
from kincal.pipeline.report.numbers import significant
from kincal.pipeline.report.pages import environment
from kincal.pipeline.report.parameters import collinear_lines, parameter_table
from kincal.pipeline.report.tables import comparison_tables, structure_table, wave_table
from kincal.pipeline.report.verdict import verdict
from kincal.pipeline.results import VIRTUAL, Comparison, Filtered, Identified, Measured, Model
from kincal.urdf.description import Limits, Record


def page(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    pretrained: Pretrained,
    siblings: SiblingResiduals,
    fits: Fits,
    compared: Comparison,
    limits: Limits,
    record: Record,
) -> str:
    """The whole report of one robot."""
    shipped, corrected = fits.identified.shipped, fits.hybrids.fits[0]
    assert compared.advice is not None
    with rc_context(STYLE):
        figures: dict[str, Any] = {
            "methods": _methods(compared),
            "singular_values": _drawn(singular_values, shipped, 3.0),
            "changes": _drawn(changes, shipped, 3.0),
            "residuals": _residuals(fits.identified),
            "training": _training(pretrained, fits.transferred.fits[0], siblings),
        }
    return (
        environment(Path(__file__).parent / "templates")
        .get_template("page.html")
        .render(
            model=model,
            campaign=measured.campaign,
            virtual=measured.truth is not None,
            VIRTUAL=VIRTUAL,
            record=record,
            verdict=verdict(limits, compared, compared.advice.method),
            findings=finding_lines(shipped.findings, [(o.pose, o.reason) for o in shipped.outliers], most=1000),
            directions=direction_lines(shipped.unobservable),
            filtered=filtered,
            corrected=corrected,
            waves=wave_table(corrected.correction, model),
            structures=structure_table(corrected.correction),
            shipped=shipped,
            compared=compared,
            comparison=comparison_tables(compared.methods, compared.raw_nominal),
            held_out=comparison_tables(compared.held_out),
            closed_loop=comparison_tables(compared.closed_loop),
            parameters=parameter_table(shipped),
            collinear=collinear_lines(shipped),
            channels=BY_ROWS,
            significant=significant,
            **figures,
        )
    )


def _svg(figure: Figure) -> Markup:
    return Markup(inline(svg(figure)))


def _axes(width: float, height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    clean(axes)
    return figure, axes


def _drawn(draw: Callable[[Identification, Any], None], identification: Identification, height: float) -> Markup:
    figure = Figure(figsize=(9.0, height), layout="constrained")
    draw(identification, figure.add_subplot())
    return _svg(figure)


def _methods(compared: Comparison) -> Markup:
    in_degrees = compared.methods[0].mean_deg is not None
    key, unit = ("deg", "degrees") if in_degrees else ("mm", "mm")
    rows = [compared.raw_nominal, *compared.methods]
    mean, largest = ([getattr(row, f"{index}_{key}") for row in rows] for index in ("mean", "max"))
    figure, axes = _axes(6.4, 0.9 + 0.36 * len(rows))
    places = np.arange(len(rows))
    axes.barh(places, mean, height=0.55, color=BLUE, label="mean")
    axes.scatter(largest, places, color=RED, marker="|", s=140, label="maximum")
    axes.set_yticks(places, [row.name for row in rows])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel(f"volumetric error [{unit}]")
    axes.legend(loc="lower right", frameon=False)
    return _svg(figure)


def _training(pretrained: Pretrained, learned: Learned, siblings: SiblingResiduals) -> Markup:
    """Training (full) and validation (dashed) loss; the source task, the measured poses, the siblings' residuals."""
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    left, right, other = figure.subplots(1, 3, sharey=True)
    half = learned.curve.shape[1] // 2
    names = ("network", "transfer", "transfer_identified")
    curves: tuple[tuple[Any, str, np.ndarray, np.ndarray, tuple[str, ...]], ...] = (
        (left, "pre-training", pretrained.curve[:, :1], pretrained.curve[:, 1:], ("source task",)),
        (right, "measured poses", learned.curve[:, :half], learned.curve[:, half:], names),
        (other, "virtual siblings", siblings.curve[:, :1], siblings.curve[:, 1:], ("residuals",)),
    )
    for axes, title, train, held, labels in curves:
        for k, (name, colour) in enumerate(zip(labels, (BLUE, RED, GREY), strict=False)):
            axes.semilogy(train[:, k], color=colour, lw=1, label=name)
            axes.semilogy(held[:, k], color=colour, lw=1, ls="--")
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("iteration")
        clean(axes)
        axes.legend(frameon=False, fontsize=8)
    left.set_ylabel("mean square, scaled")
    return _svg(figure)


def _residuals(identified: Identified) -> Markup:
    shipped = identified.shipped
    size = np.sqrt(np.mean(shipped.residual**2, axis=1))
    outliers = np.isin(shipped.poses, [o.pose for o in shipped.outliers])
    figure, axes = _axes(6.4, 2.8)
    axes.vlines(shipped.poses, 0, size, color=BLUE, lw=1)
    if outliers.any():
        axes.plot(shipped.poses[outliers], size[outliers], "o", color=RED, label="outlier")
    axes.axhline(1, color=GREY, lw=1, ls="--", label="one sigma of the sensor")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("pose")
    axes.set_ylabel("residual [sigma]")
    axes.legend(frameon=False)
    return _svg(figure)
