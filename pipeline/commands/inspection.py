"""What `kincal inspect` prints."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from kincal.pipeline.commands.console import say, show_findings, show_table
from kincal.pipeline.report.inspection import direction_lines, moved_table, rank_line, verdict_line
from kincal.pipeline.report.parameters import foreseen_table, parameter_table, sensor_sigmas, summary_lines

if TYPE_CHECKING:
    from kincal.pipeline.interface.campaign import Foresight
    from kincal.pipeline.interface.fit import Fit


def show_foresight(foresight: Foresight) -> None:
    """What an identification will be, before anybody has measured."""
    name, identification = foresight.robot.description.name, foresight.foreseen.identification
    channels = ", ".join(identification.channels)
    say(f"{name}: prediction for {identification.n_poses} planned poses ({channels})", "bold")
    show_table(foreseen_table(identification))
    _show([*summary_lines(identification), *foresight.foreseen.lines(), *_directions(identification.unobservable)])
    _show(f"Finding: {finding}." for finding in identification.findings)


def show_inspection(fit: Fit) -> None:
    """An identification in one screen: the verdict, the findings, the parameters that moved."""
    identification = fit.identification
    say(_title(fit), "bold")
    say(verdict_line(identification), "bold")
    show_findings(fit)
    _show([rank_line(identification)])
    table, more = moved_table(identification)
    if table.rows:
        _show(["Identifiable parameters that moved by more than two sigmas:"])
        show_table(table)
    else:
        _show(["No identifiable parameter moved by more than two sigmas."])
    rest = f"{more} more moved. " if more else ""
    _show([f"{rest}With --all: every parameter, correlations, and the directions that are not determined."])


def show_whole_inspection(fit: Fit) -> None:
    """An identification with all its parameters."""
    identification = fit.identification
    say(_title(fit), "bold")
    say(verdict_line(identification), "bold")
    show_findings(fit)
    show_table(parameter_table(identification))
    estimated = ", ".join(identification.sensor_estimated)
    lines = [
        *summary_lines(identification),
        f"sensors, one sigma: {sensor_sigmas(identification)}"
        + (f" ({estimated} estimated from residuals)" if estimated else ""),
        f"chi-square {identification.chi_square:.4g} over {identification.degrees_of_freedom:.1f} degrees of freedom; "
        f"{identification.message} after {identification.iterations} iterations, "
        f"shrinkage {identification.shrinkage:.3g}",
    ]
    _show([*lines, *_directions(fit.unobservable)])


def _title(fit: Fit) -> str:
    identification = fit.identification
    robot = "virtual robot" if fit.robot.description.measure.virtual else "measured"
    channels = ", ".join(identification.channels)
    return (
        f"{fit.robot.description.name}: geometry identified from {identification.n_poses} poses ({robot}: {channels}) "
        f"by {identification.estimator}, {identification.loss} loss"
    )


def _directions(unobservable: tuple[str, ...]) -> list[str]:
    lines = direction_lines(unobservable)
    return [f"{len(unobservable)} directions are not determined:", *(f"  {direction}" for direction in lines)]


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        say(line)
