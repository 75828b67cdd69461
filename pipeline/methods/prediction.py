"""Predictions as a table: poses as they would be measured, and how sure they are."""

from __future__ import annotations

import numpy as np
import pandas as pd

from kincal.identification.measurements import quaternions
from kincal.pipeline.methods.calibrated import Calibrated
from kincal.pipeline.methods.covariance import radius, seen_from, sigma
from kincal.pipeline.methods.predictors import HybridMethod


def predicted_table(calibrated: Calibrated, method: str, numbers: np.ndarray, readings: np.ndarray) -> pd.DataFrame:
    """Poses at readings (n, n_actuated), one row a reading: only what was measured can be predicted.

    With `geometric` and `hybrid`: sigmas of the robot's pose, about (along) each axis, root mean square over the axes,
    and the radius of the region that holds it with 95 %, [rad] and [m]; an instrument's noise comes on top. `share` is
    how much of the correction is believed there: 0 far outside the measured poses. Raises InputError.
    """
    channels, chosen = calibrated.channels, calibrated.methods[method]
    pose = chosen.predict(readings)
    r = pose.rotation
    covariance = calibrated.covariance(method, readings)
    turned = moved = None
    if covariance is not None:
        turned, moved = covariance[:, :3, :3], covariance[:, 3:, 3:]
    columns: dict[str, np.ndarray] = {"pose": numbers}
    if "orientation" in channels:
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternions(r).T, strict=True)) | _sure("orientation", turned)
    if "position" in channels:
        columns |= dict(zip("xyz", pose.translation.T, strict=True)) | _sure("position", moved)
    if "tilt" in channels:
        columns |= {"roll": np.arctan2(r[:, 2, 1], r[:, 2, 2]), "pitch": -np.arcsin(r[:, 2, 0])}
        columns |= _sure("tilt", None if turned is None else seen_from(turned, r[:, 2]), axes=2)
    if "yaw" in channels:
        up = r[:, 2, :, None]
        columns |= {"yaw": np.arctan2(r[:, 1, 0], r[:, 0, 0])}
        columns |= _sure("yaw", None if turned is None else up.swapaxes(1, 2) @ turned @ up, axes=1)
    if isinstance(chosen, HybridMethod):
        columns["share"] = chosen.correction.share(readings)
    return pd.DataFrame(columns)


def _sure(what: str, covariance: np.ndarray | None, axes: int = 3) -> dict[str, np.ndarray]:
    if covariance is None:
        return {}
    return {f"{what}_std": sigma(covariance, axes), f"{what}_95": radius(covariance)}
