"""Identification: what the robot is, how sure we are, and what the measurements could not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HUMAN = {  # SI units, and those that people read
    "m": ("mm", 1e3),
    "rad": ("deg", 180 / np.pi),
    "m/reading": ("mm/reading", 1e3),
    "rad/reading": ("deg/reading", 180 / np.pi),
}


@dataclass(frozen=True)
class Outlier:
    pose: int
    reason: str


@dataclass(frozen=True)
class Collinearity:
    """Belsley's diagnostics of the identifiable parameters, columns of unit length, W and T projected out.

    Belsley, Kuh, Welsch 1980, Regression Diagnostics: a condition index above 30 with two proportions above 0.5 names
    parameters that the poses hardly tell apart; a variance inflation factor above 10 says of one how badly.
    """

    parameters: tuple[str, ...]  # (r,) a largest set that the data tell apart, best seen first
    inflation: np.ndarray  # (r,) variance inflation factors
    condition_indexes: np.ndarray  # (r,) ascending
    proportions: np.ndarray  # (r, r) share of each parameter's variance (column) at each condition index (row)


@dataclass(frozen=True)
class Identification:
    """One estimate with everything that is said about it. Arrays are (n_parameters,) unless noted."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: np.ndarray
    change: np.ndarray  # p: identified = nominal + change
    tolerance: np.ndarray  # one sigma of the prior; infinite: flat
    data_share: np.ndarray  # of each change: what the data say of it, 0 .. 1; the rest is the prior's
    std: np.ndarray  # one sigma; infinite where neither data nor prior see the parameter
    covariance: np.ndarray  # (n_parameters, n_parameters)
    observable_share: np.ndarray
    identifiable: np.ndarray
    singular_values: np.ndarray
    poses: np.ndarray  # (n,) the measured poses' numbers
    residual: np.ndarray  # (n, rows a pose), whitened
    rank: int
    rank_tolerance: float
    rank_gap: float  # the last singular value above it over the first below
    condition_number: float
    unobservable: tuple[str, ...]
    unobservable_basis: np.ndarray  # (n_parameters - rank, n_parameters) orthonormal, parameters in their tolerances
    collinearity: Collinearity
    n_poses: int
    channels: tuple[str, ...]
    sensor_std: dict[str, float]  # root mean square of each channel's sigma [rad, m]
    sensor_estimated: dict[str, float]  # channels whose sigma nobody gave: what the assumed one is multiplied by
    estimator: str
    loss: str
    shrinkage: float  # the scale of the priors, ridge's k, Liu's d, or the directions kept
    iterations: int
    message: str
    chi_square: float
    degrees_of_freedom: float  # rows less the effective number of parameters
    # root mean square over poses of what identification leaves: the length of each channel's error, and the change of
    # each actuated joint that explains the pose; None: not measured
    residual_size: dict[str, float | None]
    outliers: tuple[Outlier, ...]
    findings: tuple[str, ...]  # what an engineer should know before signing
