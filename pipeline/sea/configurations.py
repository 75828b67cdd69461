"""The paper's own experiment (section 4, tables 3 and 4): the measured configurations, compensated one by one.

The ship lies still in each of the attitudes and the platform is commanded to undo it. The methods have been taught 80 %
of the configurations, the training ones, and are judged on the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from kincal.identification.channels import parts
from kincal.pipeline.compensator.commands import attempt
from kincal.pipeline.compensator.goal import filled
from kincal.pipeline.sea.trial import Platform, deck_error
from kincal.pipeline.virtual.robot import STANDING


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
    desired = filled(parts(channels), actual, drawn)
    force = g * desired.rotation[:, :, 2]  # the deck is level, the ship is not
    errors, tilted = {}, {}
    for name, method in platform.methods.items():
        tried = attempt(platform.solvers.of(method, channels), desired, model.chain, model.actuators)
        rows = np.flatnonzero(tried.good(model.chain, platform.description.workspace))
        for errors_there, load in ((errors, STANDING), (tilted, force[rows])):
            poses = platform.poses(tried.readings[rows], load)
            errors_there[name] = np.full((len(readings), 3), np.nan)
            errors_there[name][rows] = deck_error(desired.rotation[rows], poses, platform.full)
    return Configurations(desired.rotation, test, errors, tilted)
