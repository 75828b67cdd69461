"""The report."""

from __future__ import annotations

from kincal.pipeline.learned import Fits, Pretrained, SiblingResiduals
from kincal.pipeline.results import Comparison, Filtered, Html, Measured, Model, Report
from kincal.urdf.description import Limits, Record


def report_stage(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    pretrained: Pretrained,
    siblings: SiblingResiduals,
    fits: Fits,
    compared: Comparison,
    limits: Limits,
    record: Record,
) -> Report:
    """A page to sign: verdict, findings, comparison, residuals, parameters, training."""
    from kincal.pipeline.report.page import page

    return Report(Html(page(model, measured, filtered, pretrained, siblings, fits, compared, limits, record)))
