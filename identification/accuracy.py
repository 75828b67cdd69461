"""Orientation and position error, and the paper's indices (Xu, Tian, Zhang 2024, eq. 7-10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.channels import scored
from kincal.identification.channels.orientation import orientation_error as orientation_error
from kincal.identification.channels.tilt import gravity_error as gravity_error
from kincal.urdf.rigid_motion import Motion

_Statistics = tuple[float | None, float | None, float | None]


@dataclass(frozen=True)
class Score:
    """Mean, maximum and standard deviation of volumetric errors (eq. 9) and per axis (eq. 10). None: not measured."""

    mean_deg: float | None
    max_deg: float | None
    sd_deg: float | None
    axis_mean_deg: dict[str, float | None]
    mean_mm: float | None
    max_mm: float | None
    sd_mm: float | None


def score(actual: Motion, predicted: Motion, channels: tuple[str, ...]) -> Score:
    """Errors of predicted against actual poses (n), of what `channels` measured: of angles and of lengths.

    Tilt without a heading is scored by the angle between the gravity directions, and about z there is nothing.
    """
    turned: _Statistics = (None, None, None)
    moved: _Statistics = (None, None, None)
    axes: dict[str, float | None] = dict.fromkeys("xyz")
    for unit, channel in scored(channels).items():
        error = channel.error(actual, predicted)
        if unit == "rad":
            error = np.rad2deg(error)
            turned = _statistics(np.linalg.norm(error, axis=1))
            axes |= {axis: float(np.mean(np.abs(error[:, k]))) for k, axis in enumerate(channel.score_axes)}
        else:
            moved = _statistics(1e3 * np.linalg.norm(error, axis=1))
    return Score(*turned, axes, *moved)


def _statistics(values: np.ndarray) -> tuple[float, float, float]:
    """Mean, maximum and standard deviation over all poses."""
    return float(np.mean(values)), float(np.max(values)), float(np.std(values))
