"""From the filter's steps, one a block, to attitude at every sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from kincal.identification.attitude.blocks import Blocks
from kincal.identification.attitude.error_state import Update
from kincal.identification.attitude.innovations import statistics
from kincal.identification.attitude.motion import Nominal
from kincal.identification.attitude.settings import AttitudeEstimate, InnovationStatistics
from kincal.urdf.rigid_motion import exp, zyx_angles


@dataclass(frozen=True)
class Stretch:
    """One block: where it started and what the filter knows at its end."""

    start: Nominal
    turn: np.ndarray  # (3,) in the level frame, without a gyro [rad]
    end: Nominal
    covariance: np.ndarray  # (3, 3) of the attitude in the level frame [rad2]
    bias_free: np.ndarray  # (2, 2) of its x and y, but for the bias of the acceleration
    force: Update
    heading: Update
    correction: np.ndarray | None = None  # (2, 3) of a smoother: rotation vectors in the level frame, start and end


def estimate(n: int, blocks: Sequence[Blocks], stretches: Sequence[Stretch], learning: int) -> AttitudeEstimate:
    """At the n samples of the blocks; a stretch's last sample has the update in it.

    learning: blocks whose innovations don't count, as the filter was still learning what to expect of them.
    """
    size = blocks[0].elapsed.shape[1]

    def each(values) -> np.ndarray:
        return np.repeat(np.array(values), size, axis=0)[:n]

    start = np.array([s.start.rotation for s in stretches])
    gyro_bias, turn = np.array([s.start.gyro_bias for s in stretches]), np.array([s.turn for s in stretches])
    corrections = [s.correction for s in stretches if s.correction is not None]
    angles, first = [], 0
    for part in blocks:
        rows = slice(first, first + len(part.dt))
        rotation = within(part, start[rows], gyro_bias[rows], turn[rows])
        if corrections:
            before, after = np.array(corrections[rows])[:, :, None].swapaxes(0, 1)
            rotation = exp(before + part.share[:, :, None] * (after - before)) @ rotation
        angles.append(roll_pitch_yaw(rotation).reshape(-1, 3))
        first = rows.stop
    all_angles = np.concatenate(angles)[:n]
    ends = np.minimum(np.arange(1, len(stretches) + 1) * size, n) - 1
    rotations = np.array([s.end.rotation for s in stretches])
    all_angles[ends] = roll_pitch_yaw(rotations)
    std, bias_free_std = deviations(
        rotations, np.array([s.covariance for s in stretches]), np.array([s.bias_free for s in stretches])
    )
    return AttitudeEstimate(
        roll_pitch_yaw=all_angles,
        std=each(std),
        bias_free_std=each(bias_free_std),
        gyro_bias=each([s.end.gyro_bias for s in stretches]),
        acceleration_bias=each([s.end.bias for s in stretches]),
        acceleration=each([s.end.acceleration for s in stretches]),
        innovations=innovation_statistics(stretches[learning:]),
    )


def within(blocks: Blocks, start: np.ndarray, gyro_bias: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(b, m, 3, 3) rotations at all samples, from those at the starts of the blocks (b, 3, 3)."""
    own = blocks.partial - blocks.elapsed[:, :, None] * gyro_bias[:, None]
    return exp(blocks.share[:, :, None] * turn[:, None]) @ start[:, None] @ exp(own)


def roll_pitch_yaw(rotation: np.ndarray) -> np.ndarray:
    """(..., 3) [rad] of rotations (..., 3, 3)."""
    return zyx_angles(rotation)[..., ::-1]


def bias_free(covariance: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """(2, 2) of the turn about x and y, but for the bias. covariance: of all errors; tilt: (2, size)."""
    turned = np.array([tilt[1], -tilt[0]]) / g  # what a level force means as a turn about x and y
    return turned @ covariance @ turned.T


def deviations(rotation: np.ndarray, covariance: np.ndarray, net: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(b, 3) one sigma of roll, pitch and yaw, and (b, 2) of roll and pitch but for the acceleration's bias [rad].

    covariance: (b, 3, 3) of the attitude in the level frame; net: (b, 2, 2) as `bias_free` gives it.
    """
    yaw, pitch, _ = zyx_angles(rotation).T
    c, s, tangent, zero = np.cos(yaw), np.sin(yaw), np.tan(pitch), np.zeros_like(yaw)
    rows = [c / np.cos(pitch), s / np.cos(pitch), zero, -s, c, zero, c * tangent, s * tangent, zero + 1]
    rates = np.stack(rows, axis=-1).reshape(-1, 3, 3)
    level = rates[:, :2, :2]
    return (
        np.sqrt(np.einsum("bij,bjk,bik->bi", rates, covariance, rates)),
        np.sqrt(np.einsum("bij,bjk,bik->bi", level, net, level)),
    )


def innovation_statistics(stretches: Sequence[Stretch]) -> tuple[InnovationStatistics, ...]:
    statistics_by_kind = []
    for channel in ("force", "heading"):
        updates: list[Update] = [getattr(s, channel) for s in stretches]
        accepted = [(u.normalised, u.gated) for u in updates if u.normalised is not None]
        if accepted:
            values, gated = zip(*accepted, strict=True)
            statistics_by_kind.append(statistics(channel, np.array(values), np.array(gated)))
    return tuple(statistics_by_kind)
