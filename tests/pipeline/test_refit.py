"""A calibrated robot on another day: its instrument set up anew, its actuators homed anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kincal.pipeline.methods.predictors import ModelMethod
from kincal.pipeline.methods.refit import refitted
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion, exp


def another_day(robot, name: str, channels: tuple[str, ...], seed: int):
    """A method, and measurements of the same robot with W moved by any motion and the zeros by some millimetres."""
    loaded, random = robot(name), np.random.default_rng(seed)
    known = loaded.random_parameters(seed)
    moved, n = known.copy(), len(loaded.model.actuators.gain)
    motion = Motion(exp(random.normal(size=3)), random.normal(size=3))
    moved[-12:-6] = (motion @ loaded.model.robot(known).instrument).vector()
    moved[-12 - 2 * n : -12 - n] += 2e-3 * random.normal(size=n)
    readings = loaded.readings(40, seed)
    measured = loaded.measure(moved, readings, channels)
    return ModelMethod(loaded.model.robot(known)), ModelMethod(loaded.model.robot(moved)), measured, loaded


@pytest.mark.parametrize("name, channels", [("ups3_s", ("orientation",)), ("jugglebot", ("orientation", "position"))])
def test_known_motion_and_zeros_come_back(robot, name, channels):
    """Poses that the fit has not seen are predicted as the moved robot has them."""
    for seed in range(2):
        method, truth, measured, loaded = another_day(robot, name, channels, seed)
        found = refitted(method, measured, register=True, rehome=True)
        fresh = loaded.readings(50, seed + 10)
        predicted, actual = found.predict(fresh), truth.predict(fresh)
        assert np.abs(predicted.rotation - actual.rotation).max() < 1e-7
        if "position" in channels:
            assert np.abs(predicted.translation - actual.translation).max() < 1e-7


def test_registering_alone_does_not_touch_the_zeros(robot):
    """What was not asked for stays; and the error that it leaves is seen."""
    method, truth, measured, _ = another_day(robot, "ups3_s", ("orientation",), 3)
    found = refitted(method, measured, register=True, rehome=False)
    assert np.array_equal(found.shift, np.zeros(3))
    assert np.abs(found.predict(measured.readings).rotation - truth.predict(measured.readings).rotation).max() > 1e-4


def test_too_few_poses_are_refused(robot):
    method, _, measured, _ = another_day(robot, "ups3_s", ("orientation",), 5)
    with pytest.raises(InputError, match="2 poses can't register"):
        refitted(method, replace(measured[:2]), register=True, rehome=False)
