"""What people get wrong in a channel's own values: each channel knows its mistakes."""

from __future__ import annotations

from collections.abc import Iterator

from kincal.identification.channels import named
from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.identification.mistakes.mistake import Mistake, of_values


def wrong_values(model: ErrorModel, measured: Measurements) -> Iterator[Mistake]:
    """Another unit, another order, a turned sign; lengths first."""
    for channel in sorted(named(measured.channels), key=lambda c: c.unit):
        for cause, change in channel.mistakes():
            yield of_values(cause, channel, change)
