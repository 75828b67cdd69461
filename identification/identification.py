"""Identification: what the robot is, how sure we are, and what the measurements could not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ResidualSize:
    """Root mean square of what identification leaves, over poses; None: not measured."""

    orientation_deg: float | None  # of the rotation vector's length
    position_mm: float | None  # of the position error's length
    tilt_deg: float | None
    yaw_deg: float | None
    prismatic_mm: float | None  # along each prismatic actuator: the change of its joint that explains the pose
    revolute_deg: float | None


@dataclass(frozen=True)
class Outlier:
    pose: int
    reason: str


@dataclass(frozen=True)
class Identification:
    """One estimate with everything that is said about it. Arrays are (n_parameters,) unless noted."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: np.ndarray
    change: np.ndarray  # p: identified = nominal + change
    tolerance: np.ndarray  # one sigma of the prior; infinite: flat
    std: np.ndarray  # one sigma; infinite where neither data nor prior see the parameter
    covariance: np.ndarray  # (n_parameters, n_parameters)
    observable_share: np.ndarray
    identifiable: np.ndarray
    singular_values: np.ndarray
    poses: np.ndarray  # (n,) the measured poses' numbers
    residual: np.ndarray  # (n, rows a pose), whitened
    rank: int
    rank_tolerance: float
    condition_number: float
    unobservable: tuple[str, ...]
    n_poses: int
    channels: tuple[str, ...]
    iterations: int
    message: str
    chi_square: float
    degrees_of_freedom: float  # rows less the effective number of parameters
    residual_size: ResidualSize
    outliers: tuple[Outlier, ...]
