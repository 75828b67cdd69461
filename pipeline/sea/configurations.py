"""The paper's own experiment (section 4, tables 3 and 4): the measured configurations, compensated one by one.

The ship lies still in each of the attitudes and the platform is commanded to undo it. The methods have been taught 80 %
of the configurations, the training ones, and are judged on the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from identification.channels import parts
from pipeline.compensation import attempt
from pipeline.goal import Goal
from pipeline.sea.trial import Platform, deck_error
from pipeline.virtual_robot import STANDING

# Xu, Tian & Zhang 2024, tables 3 and 4, in degrees: (x, y, z, volumetric) on the testing configurations
PAPER: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "nominal": {
        "mean": (0.245, 0.051, 0.043, 0.257),
        "max": (0.495, 0.150, 0.151, 0.506),
        "sd": (0.093, 0.038, 0.033, 0.090),
    },
    "network": {
        "mean": (0.015, 0.025, 0.032, 0.051),
        "max": (0.138, 0.125, 0.159, 0.245),
        "sd": (0.025, 0.032, 0.037, 0.049),
    },
    "transfer": {
        "mean": (0.009, 0.006, 0.008, 0.017),
        "max": (0.055, 0.026, 0.056, 0.062),
        "sd": (0.011, 0.006, 0.010, 0.014),
    },
}


@dataclass(frozen=True)
class Configurations:
    """Errors at n configurations, in the order in which they were measured."""

    desired: np.ndarray  # (n, 3, 3) of the deck on board
    test: np.ndarray  # (k,) the testing configurations; the others are for training
    errors: Mapping[str, np.ndarray]  # {method: (n, 3) of the deck's orientation [rad]; NaN without a command}
    tilted: Mapping[str, np.ndarray]  # the same under the load of the ship's tilt, which calibration has not seen


def configurations(platform: Platform, readings: np.ndarray, test: np.ndarray) -> Configurations:
    """Compensate the configurations that the drawing has at readings (n, n_actuated), by methods that know n - k.

    Desired are orientations that the robot as built can have, parasitic motion included.
    """
    model, channels = platform.model, platform.channels
    actual = platform.actual.pose(readings, platform.actual.after_campaign(readings))
    drawn = platform.methods["nominal"].predict(readings)
    desired = Goal(platform.actual.robot, actual, parts(channels)).filled(drawn)
    force = g * desired.rotation[:, :, 2]  # the deck is level, the ship is not
    errors, tilted = {}, {}
    for name, method in platform.methods.items():
        tried = attempt(method, desired, model.chain, model.actuators, channels)
        rows = np.flatnonzero(tried.good(model.chain, platform.description.workspace))
        for found, load in ((errors, STANDING), (tilted, force[rows])):
            there = platform.poses(tried.readings[rows], load)
            found[name] = np.full((len(readings), 3), np.nan)
            found[name][rows] = deck_error(desired.rotation[rows], there, platform.full)
    return Configurations(desired.rotation, test, errors, tilted)
