"""Predictions as a table: poses as they would be measured, and how sure they are."""

from __future__ import annotations

import numpy as np
import pandas as pd

from kincal.identification.channels import CHANNELS
from kincal.pipeline.methods.calibrated import Calibrated
from kincal.pipeline.methods.covariance import radius, sigma
from kincal.pipeline.methods.predictors import HybridMethod


def predicted_table(calibrated: Calibrated, method: str, numbers: np.ndarray, readings: np.ndarray) -> pd.DataFrame:
    """Poses at readings (n, n_actuated), one row a reading: only what was measured can be predicted.

    With `geometric` and `hybrid`: sigmas of the robot's pose, about (along) each axis, root mean square over the axes,
    and the radius of the region that holds it with 95 %, [rad] and [m]; an instrument's noise comes on top. `share` is
    how much of the correction is believed there: 0 far outside the measured poses. Raises InputError.
    """
    channels, chosen = calibrated.channels, calibrated.methods[method]
    pose = chosen.predict(readings)
    covariance = calibrated.covariance(method, readings)
    columns: dict[str, np.ndarray] = {"pose": numbers}
    for channel in (c for c in CHANNELS if c.name in channels):
        columns |= channel.write(channel.of(pose))
        if covariance is not None:
            shown = channel.covariance(covariance, pose.rotation)
            columns |= {f"{channel.name}_std": sigma(shown, channel.rows), f"{channel.name}_95": radius(shown)}
    if isinstance(chosen, HybridMethod):
        columns["share"] = chosen.correction.share(readings)
    return pd.DataFrame(columns)
