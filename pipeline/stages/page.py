"""The report."""

from __future__ import annotations

from kincal.pipeline.results import (
    Comparison,
    Filtered,
    Html,
    Hybrids,
    Identified,
    Measured,
    Model,
    Pretrained,
    Report,
    SiblingResiduals,
    Transferred,
)


def report(
    model: Model,
    measured: Measured,
    filtered: Filtered,
    identified: Identified,
    pretrained: Pretrained,
    transferred: Transferred,
    siblings: SiblingResiduals,
    hybrids: Hybrids,
    compared: Comparison,
) -> Report:
    """A page to sign: comparison, parameters, singular values, residuals, training."""
    from kincal.pipeline.report.page import page

    return Report(
        Html(page(model, measured.campaign, filtered, identified, pretrained, transferred, siblings, hybrids, compared))
    )
