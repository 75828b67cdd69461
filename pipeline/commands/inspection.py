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
    name, found = foresight.robot.description.name, foresight.foreseen.identification
    out.print(Text(f"{name}: what {found.n_poses} planned poses will tell ({', '.join(found.channels)})", "bold"))
    show_table(foreseen_table(found))
    _show([*summary_lines(found), *foresight.foreseen.lines(), *_directions(found.unobservable)])
    _show(f"finding: {finding}" for finding in found.findings)


def show_inspection(fit: Fit) -> None:
    """An identification."""
    name, found = fit.robot.description.name, fit.identification
    poses = f"{found.n_poses} poses ({', '.join(found.channels)})"
    out.print(Text(f"{name}: parameters identified from {poses} by {found.estimator}, {found.loss} loss", "bold"))
    show_table(parameter_table(found))
    estimated = f" ({', '.join(found.sensor_estimated)} estimated from residuals)" if found.sensor_estimated else ""
    lines = [
        *summary_lines(found),
        f"sensors, one sigma: {sensor_sigmas(found)}{estimated}",
        f"chi-square {found.chi_square:.4g} over {found.degrees_of_freedom:.1f} degrees of freedom; "
        f"{found.message} after {found.iterations} iterations, shrinkage {found.shrinkage:.3g}",
    ]
    _show([*lines, *_directions(fit.unobservable)])
    _show(f"finding: {finding}" for finding in fit.findings)
    _show(f"outlier: pose {outlier.pose}: {outlier.reason}" for outlier in found.outliers)


def _directions(unobservable: tuple[str, ...]) -> list[str]:
    return [f"{len(unobservable)} unobservable directions:", *(f"  {direction}" for direction in unobservable)]


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        out.print(Text(line), soft_wrap=True)
