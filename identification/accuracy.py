"""Orientation and position error, and the paper's indices (Xu, Tian, Zhang 2024, eq. 7-10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.identification.channels import all_turns
from kincal.urdf.rigid_motion import Motion, log


def orientation_error(actual: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(n, 3) [rad]: the rotation vector of R_actual^-1 R_predicted.

    For small errors the vector of its skew part (eq. 7 and 8), which it equals to third order; but half a turn is one.
    """
    return log(np.swapaxes(actual, -1, -2) @ predicted)


def gravity_error(actual: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(n, 3) [rad]: the same between the verticals alone, seen from the tool; what tilt can tell. About z: 0 at level.

    The vertical in the tool's frame is the orientation's third row; the error is the smallest rotation between the two.
    """
    first, second = actual[..., 2, :], predicted[..., 2, :]
    axis = np.cross(second, first)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = np.sum(first * second, axis=-1, keepdims=True)
    return axis * np.where(sine > 1e-12, np.arctan2(sine, cosine) / np.maximum(sine, 1e-12), 1.0)


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
    """Errors of predicted against actual poses (n), of what `channels` measured: orientation or tilt, and position.

    Tilt without a heading is scored by the angle between the gravity directions, and about z there is nothing.
    """
    full = all_turns(channels)
    turned: tuple[float | None, float | None, float | None] = (None, None, None)
    axes: list[float | None] = [None] * 3
    if full or "tilt" in channels:
        error = np.rad2deg((orientation_error if full else gravity_error)(actual.rotation, predicted.rotation))
        turned = _statistics(np.linalg.norm(error, axis=1))
        axes = [float(np.mean(np.abs(error[:, k]))) for k in range(3)]
        axes[2] = axes[2] if full else None
    moved: tuple[float | None, float | None, float | None] = (None, None, None)
    if "position" in channels:
        moved = _statistics(1e3 * np.linalg.norm(predicted.translation - actual.translation, axis=1))
    return Score(*turned, dict(zip("xyz", axes, strict=True)), *moved)


def _statistics(values: np.ndarray) -> tuple[float, float, float]:
    """Mean, maximum and standard deviation over all poses."""
    return float(np.mean(values)), float(np.max(values)), float(np.std(values))
