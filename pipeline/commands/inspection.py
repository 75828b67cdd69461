"""What `kincal inspect` prints."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.text import Text

from kincal.pipeline.commands.console import out, show_table
from kincal.pipeline.report.tables import foreseen_table, parameter_table, sensor_sigmas, summary_lines

if TYPE_CHECKING:
    from kincal.pipeline.interface.campaign import Foresight
    from kincal.pipeline.interface.fit import Fit


def show_foresight(foresight: Foresight) -> None:
    """What an identification will be, before anybody has measured."""
    name, identification = foresight.robot.description.name, foresight.foreseen.identification
    out.print(
        Text(
            f"{name}: what {identification.n_poses} planned poses will tell ({', '.join(identification.channels)})",
            "bold",
        )
    )
    show_table(foreseen_table(identification))
    _show([*summary_lines(identification), *foresight.foreseen.lines(), *_directions(identification.unobservable)])
    _show(f"finding: {finding}" for finding in identification.findings)


def show_inspection(fit: Fit) -> None:
    """An identification."""
    name, identification = fit.robot.description.name, fit.identification
    poses = f"{identification.n_poses} poses ({', '.join(identification.channels)})"
    out.print(
        Text(
            f"{name}: parameters identified from {poses} by {identification.estimator}, {identification.loss} loss",
            "bold",
        )
    )
    show_table(parameter_table(identification))
    estimated = (
        f" ({', '.join(identification.sensor_estimated)} estimated from residuals)"
        if identification.sensor_estimated
        else ""
    )
    lines = [
        *summary_lines(identification),
        f"sensors, one sigma: {sensor_sigmas(identification)}{estimated}",
        f"chi-square {identification.chi_square:.4g} over {identification.degrees_of_freedom:.1f} degrees of freedom; "
        f"{identification.message} after {identification.iterations} iterations, "
        f"shrinkage {identification.shrinkage:.3g}",
    ]
    _show([*lines, *_directions(fit.unobservable)])
    _show(f"finding: {finding}" for finding in fit.findings)
    _show(f"outlier: pose {outlier.pose}: {outlier.reason}" for outlier in identification.outliers)


def _directions(unobservable: tuple[str, ...]) -> list[str]:
    return [f"{len(unobservable)} unobservable directions:", *(f"  {direction}" for direction in unobservable)]


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        out.print(Text(line), soft_wrap=True)
