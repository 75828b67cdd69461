"""The report."""

from __future__ import annotations

from kincal.pipeline.learned import Fits, Pretrained, SiblingResiduals
from kincal.pipeline.results import Comparison, Filtered, Html, Measured, Model, Report


def report_stage(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    pretrained: Pretrained,
    siblings: SiblingResiduals,
    fits: Fits,
    compared: Comparison,
) -> Report:
    """A page to sign: comparison, parameters, singular values, residuals, training."""
    from kincal.pipeline.report.page import page

    identified, learned, corrected = fits.identified, fits.transferred.fits[0], fits.hybrids.fits[0]
    return Report(
        Html(page(model, measured.campaign, filtered, identified, pretrained, learned, siblings, corrected, compared))
    )
