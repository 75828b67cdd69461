"""The shipped 3-UPS/S against the closed form of Xu, Tian, Zhang 2024, eq. 2: |h k + R b_i - a_i|."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.urdf.kinematics import forward, inverse
from kincal.urdf.workspace import grid

BASE_RADIUS, PLATFORM_RADIUS, HEIGHT, OFFSET_DEG = 0.30, 0.20, 0.45, 45.0  # [m, m, m, deg]


def leg_lengths(rotation: np.ndarray) -> np.ndarray:
    """(n, 3) [m]: eq. 2, written from the paper and the drawing's four numbers alone."""
    azimuth = np.deg2rad([0.0, 120.0, 240.0])
    turned = azimuth + np.deg2rad(OFFSET_DEG)
    a = BASE_RADIUS * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    b = PLATFORM_RADIUS * np.stack([np.cos(turned), np.sin(turned), np.zeros(3)], axis=1)
    legs = np.array([0.0, 0.0, HEIGHT]) + np.einsum("nij,kj->nki", rotation, b) - a
    return np.linalg.norm(legs, axis=2)


@pytest.fixture(scope="module", params=["ups3_s", "ups3_frame"])
def platform(request, robot):
    return robot(request.param)


@pytest.fixture(scope="module")
def workspace_poses(platform) -> tuple[np.ndarray, np.ndarray]:
    """11^3 tool coordinates over the whole workspace, and scipy's rotations of them."""
    u = grid(platform.description.workspace, platform.chain.tool_axes, [11, 11, 11])
    return u, Rotation.from_euler("XYZ", u[:, 3:]).as_matrix()


def test_inverse_kinematics_gives_the_leg_lengths_of_eq_2(platform, workspace_poses):
    u, rotation = workspace_poses
    found = inverse(platform.chain, u)
    assert found.closed.all()
    np.testing.assert_allclose(found.q[:, platform.chain.actuated], leg_lengths(rotation), rtol=0, atol=1e-12)


def test_forward_kinematics_turns_the_leg_lengths_of_eq_2_into_the_orientation(platform, workspace_poses):
    _, rotation = workspace_poses
    found = forward(platform.chain, leg_lengths(rotation))
    assert found.closed.all()
    np.testing.assert_allclose(found.pose.rotation, rotation, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.pose.translation, np.tile([0, 0, HEIGHT], (len(rotation), 1)), atol=1e-12)
    again = leg_lengths(found.pose.rotation)
    np.testing.assert_allclose(again, found.q[:, platform.chain.actuated], rtol=0, atol=1e-12)
