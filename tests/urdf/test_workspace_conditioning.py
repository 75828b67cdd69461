"""Singularities and condition numbers, against the azimuth-offset designs of the paper's platform and its eq. 2."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import bounds, condition_numbers, grid, mobility, sample

PLATFORM_ORIGINS = (  # of ups3_s: an offset of 45 degrees
    "0.14142135623731 0.14142135623731 0",
    "-0.193185165257814 0.051763809020504 0",
    "0.051763809020504 -0.193185165257814 0",
)


def joint_centres(offset_deg: float) -> tuple[np.ndarray, np.ndarray]:
    azimuth = np.deg2rad([0.0, 120.0, 240.0])
    turned = azimuth + np.deg2rad(offset_deg)
    a = 0.30 * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    return a, 0.20 * np.stack([np.cos(turned), np.sin(turned), np.zeros(3)], axis=1)


def with_offset(edited, offset_deg: float):
    """The platform with its joints turned: the URDF's text edited."""
    _, b = joint_centres(offset_deg)
    changes = [(old, " ".join(f"{v:.15g}" for v in new)) for old, new in zip(PLATFORM_ORIGINS, b, strict=True)]
    return edited(urdf=changes)


def closed_form_condition(offset_deg: float, rotation: np.ndarray) -> np.ndarray:
    """Of d(leg lengths) / d(angular velocity) from eq. 2: rows (R b_i) x (leg direction)."""
    a, b = joint_centres(offset_deg)
    turned = np.einsum("nij,kj->nki", rotation, b)
    leg = np.array([0, 0, 0.45]) + turned - a
    leg /= np.linalg.norm(leg, axis=2, keepdims=True)
    return np.linalg.cond(np.cross(turned, leg))


@pytest.mark.parametrize("offset_deg", [30, 45, 60])
def test_worst_condition_number_is_that_of_eq_2(offset_deg, edited, checked):
    """Angular velocity and rates of XYZ angles differ by up to tan(20 degrees): half as much again at most."""
    report = checked(with_offset(edited, offset_deg))
    lines = [np.linspace(-20, 20, 11), np.linspace(-20, 20, 11), np.linspace(-10, 10, 11)]
    angles = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    worst = closed_form_condition(offset_deg, Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()).max()
    assert worst / 1.5 < report.worst_condition < 1.5 * worst
    assert report.mobility == 3
    assert report.n_checked == 11**3


def test_an_offset_of_15_degrees_is_far_worse_than_45(edited, checked, robot):
    good = checked(with_offset(edited, 45)).worst_condition
    poor = checked(with_offset(edited, 15), ("workspace.max_condition=1e4",)).worst_condition
    assert good < 4
    assert poor > 10 * good


def test_the_printed_geometry_is_refused_with_pose_and_condition_number(checked):
    """Base and platform joints at the same azimuths: singular at home (science.md, trap 1)."""
    with pytest.raises(InputError) as refusal:
        checked("ups3_s_printed")
    message = str(refusal.value)
    assert re.search(r"pose \(rx = -?0\.0 deg, ry = -?0\.0 deg, rz = -?0\.0 deg\)", message), message
    assert re.search(r"condition number (inf|\d)", message), message
    assert "max_condition = 100" in message


def test_max_condition_is_what_decides(checked):
    with pytest.raises(InputError, match=r"is singular: condition number .* max_condition = 1\.5"):
        checked("ups3_s", ("workspace.max_condition=1.5",))


@pytest.mark.parametrize("name, free", [("ups3_s", 3), ("jugglebot", 6), ("ur10", 6), ("ups3_frame", 3)])
def test_mobility_is_gruebler_counted_by_hand(name, free, robot):
    assert mobility(robot(name).chain) == free


@pytest.mark.parametrize("name", ["ups3_s", "jugglebot", "ur10"])
def test_shipped_workspaces_are_fit_for_calibration(name, checked, robot):
    report = checked(name)
    assert 1 <= report.worst_condition < 100
    assert report.mobility == len(robot(name).chain.tool_axes)


def test_condition_numbers_do_not_depend_on_the_unit_of_length(robot):
    """The platform drawn ten times as large: the same mechanism, the same condition numbers."""
    loaded = robot("jugglebot")
    q = loaded.configurations(5, 1)
    large = loaded.chain.with_geometry(loaded.chain.rotation, 10 * loaded.chain.translation)
    sliding = large.prismatic
    grown = np.where(sliding, 10 * q, q)
    tool = Motion(large.tool.rotation, 10 * large.tool.translation)
    large = replace(large, home=np.where(sliding, 10 * large.home, large.home), tool=tool)
    numbers = condition_numbers(loaded.chain, q)
    np.testing.assert_allclose(condition_numbers(large, grown), numbers, rtol=1e-8)


@pytest.mark.parametrize("even", [False, True])
def test_samples_fill_the_workspace_and_follow_the_seed(even, robot):
    loaded = robot("ur10")
    workspace, axes = loaded.description.workspace, loaded.chain.tool_axes
    u = sample(workspace, axes, 200, 3, even=even)
    low, high = bounds(workspace).T
    unit = (u[:, list(axes)] - low) / (high - low)
    assert unit.min() >= 0
    assert unit.max() <= 1
    assert np.abs(unit.mean(axis=0) - 0.5).max() < 0.1
    np.testing.assert_array_equal(u, sample(workspace, axes, 200, 3, even=even))
    assert not np.array_equal(u, sample(workspace, axes, 200, 4, even=even))


def test_grid_holds_the_corners(robot):
    loaded = robot("ups3_s")
    u = grid(loaded.description.workspace, loaded.chain.tool_axes, [3, 3, 3])
    degrees = np.rad2deg(u[:, 3:])
    assert len(np.unique(degrees.round(9), axis=0)) == 27
    np.testing.assert_allclose(degrees.min(axis=0), [-20, -20, -10])
    np.testing.assert_allclose(degrees.max(axis=0), [20, 20, 10])
    assert inverse(loaded.chain, u).closed.all()
