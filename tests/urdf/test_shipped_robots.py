"""The shipped platforms against closed forms written from their drawings' numbers alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.urdf.kinematics import forward, inverse
from kincal.urdf.workspace import grid, mobility

AZIMUTH = np.deg2rad([0.0, 120.0, 240.0])
RADIAL = np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH), np.zeros(3)], axis=1)
TANGENTIAL = np.stack([-np.sin(AZIMUTH), np.cos(AZIMUTH), np.zeros(3)], axis=1)

# Nategh and Agheli 2009, nominal: x and y of the base and platform joints [mm]
GOUGH_BASE = 1e-3 * np.array(
    [
        [305.4001, 111.1565, 0],
        [-56.4357, 320.0625, 0],
        [-248.9644, 208.9060, 0],
        [-248.9644, -208.9060, 0],
        [-56.4357, -320.0625, 0],
        [305.4001, -111.1565, 0],
    ]
)
GOUGH_PLATFORM = 1e-3 * np.array(
    [
        [92.1597, 84.4488, 0],
        [27.0550, 122.0370, 0],
        [-119.2146, 37.5882, 0],
        [-119.2146, -37.5882, 0],
        [27.0550, -122.0370, 0],
        [92.1597, -84.4488, 0],
    ]
)


def leg_lengths(base: np.ndarray, platform: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(n, k) [m]: |platform joint - base joint| of k legs at n poses."""
    return np.linalg.norm(np.einsum("nij,kj->nki", rotation, platform) + translation[:, None] - base, axis=2)


def gough_stewart(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rotation, translation = Rotation.from_euler("XYZ", u[:, 3:]).as_matrix(), u[:, :3] + [0, 0, 0.8]
    return rotation, translation, leg_lengths(GOUGH_BASE, GOUGH_PLATFORM, rotation, translation)


def linear_delta(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A carriage stands as high above the platform as its rods, 0.6 m long, reach beyond their horizontal distance."""
    rotation, translation = np.tile(np.eye(3), (len(u), 1, 1)), u[:, :3] + [0, 0, 0.2]
    apart = translation[:, None, :2] - (0.35 - 0.06) * RADIAL[:, :2]
    return rotation, translation, translation[:, None, 2] + np.sqrt(0.6**2 - np.sum(apart**2, axis=2))


def rps3(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every platform joint in its leg's plane: rz from R12 = R21, then y = -b R21 and x = b (R11 - R22) / 2."""
    rx, ry = u[:, 3], u[:, 4]
    rz = np.arctan2(-np.sin(rx) * np.sin(ry), np.cos(rx) + np.cos(ry))
    rotation = Rotation.from_euler("XYZ", np.stack([rx, ry, rz], axis=1)).as_matrix()
    x, y = 0.2 * (rotation[:, 0, 0] - rotation[:, 1, 1]) / 2, -0.2 * rotation[:, 1, 0]
    translation = np.stack([x, y, 0.5 + u[:, 2]], axis=1)
    return rotation, translation, leg_lengths(0.3 * RADIAL, 0.2 * RADIAL, rotation, translation)


def ups2_u(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A universal joint at 0.45 m, about x and then y."""
    rotation, translation = Rotation.from_euler("XY", u[:, 3:5]).as_matrix(), np.tile([0, 0, 0.45], (len(u), 1))
    return rotation, translation, leg_lengths(0.3 * np.eye(3)[:2], 0.2 * np.eye(3)[:2], rotation, translation)


DRAWN = {
    "gough_stewart": (gough_stewart, 6),
    "linear_delta": (linear_delta, 3),
    "rps3": (rps3, 3),
    "ups2_u": (ups2_u, 2),
}


@pytest.fixture(scope="module", params=DRAWN)
def drawn(request, robot):
    """A robot, tool coordinates (n, 6) in its workspace, corners included, and the closed form there."""
    loaded = robot(request.param)
    axes = loaded.chain.tool_axes
    corners = grid(loaded.description.workspace, axes, [2] * len(axes))
    u = np.concatenate([corners, loaded.coordinates(200, 1)])
    return loaded, u, *DRAWN[request.param][0](u)


def test_inverse_kinematics_gives_the_closed_forms_actuators_and_pose(drawn):
    loaded, u, rotation, translation, actuators = drawn
    found = inverse(loaded.chain, u)
    assert found.closed.all()
    np.testing.assert_allclose(found.q[:, loaded.chain.actuated], actuators, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.pose.rotation, rotation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.pose.translation, translation, rtol=0, atol=1e-12)


def test_forward_kinematics_turns_the_closed_forms_actuators_into_the_pose(drawn):
    loaded, _, rotation, translation, actuators = drawn
    found = forward(loaded.chain, actuators)
    assert found.closed.all()
    np.testing.assert_allclose(found.pose.rotation, rotation, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.pose.translation, translation, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", DRAWN)
def test_every_degree_of_freedom_has_an_actuator_and_the_workspace_is_regular(name, robot, checked):
    """By Gruebler, counted by hand; far from a singularity, on one assembly branch, within the joint limits."""
    loaded, report = robot(name), checked(name)
    free = DRAWN[name][1]
    assert report.mobility == mobility(loaded.chain) == free
    assert len(loaded.chain.actuated) == len(loaded.chain.tool_axes) == free
    assert loaded.chain.n_joints - loaded.chain.n_equations == free
    assert 1 <= report.worst_condition < 20


def test_the_platform_of_the_3_rps_keeps_its_joints_in_the_legs_planes(robot):
    """Also where forward kinematics alone decides the pose: at leg lengths that no inverse kinematics has made."""
    chain = robot("rps3").chain
    lengths = 0.5 + 0.1 * np.random.default_rng(3).uniform(-1, 1, (200, 3))
    found = forward(chain, lengths)
    assert found.closed.all()
    joints = np.einsum("nij,kj->nki", found.pose.rotation, 0.2 * RADIAL) + found.pose.translation[:, None]
    np.testing.assert_allclose(np.einsum("nki,ki->nk", joints, TANGENTIAL), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(joints - 0.3 * RADIAL, axis=2), lengths, rtol=0, atol=1e-11)
    assert np.ptp(found.pose.translation[:, :2], axis=0).min() > 1e-3  # it does wander


def test_the_rods_of_the_linear_delta_stay_parallel(robot):
    """Both rods of a leg, 0.6 m long, at carriage heights that no inverse kinematics has made: a pure translation."""
    chain = robot("linear_delta").chain
    heights = 0.72 + 0.08 * np.random.default_rng(4).uniform(-1, 1, (200, 3))
    found = forward(chain, heights)
    assert found.closed.all()
    np.testing.assert_allclose(found.pose.rotation, np.tile(np.eye(3), (200, 1, 1)), atol=1e-11)
    rods = 0.35 * RADIAL + heights[..., None] * [0, 0, 1] - (found.pose.translation[:, None] + 0.06 * RADIAL)
    np.testing.assert_allclose(np.linalg.norm(rods, axis=2), 0.6, rtol=0, atol=1e-11)
    names = chain.joint_names
    for leg in (1, 2, 3):
        for joint in ("u1", "u2"):
            one, two = (found.q[:, names.index(f"leg{leg}_rod{k}_{joint}")] for k in (1, 2))
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-11)
