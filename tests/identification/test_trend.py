"""A drift along the rows, named with its size; against drifts that were put into the measurements."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.summary import summarise
from kincal.urdf.description import Identify

SIGMA = {"orientation": np.deg2rad(0.002), "position": 1e-5, "tilt": np.deg2rad(0.002), "yaw": np.deg2rad(0.002)}


@pytest.fixture
def findings(robot):
    """findings(name, channels, change): of 60 poses with a drift, `change(measured, time)`, put into them."""

    def of(name: str, channels: tuple[str, ...], change=lambda measured, time, robot: measured) -> tuple[str, ...]:
        loaded = robot(name)
        p = loaded.random_parameters(5)
        noise = np.random.default_rng(2)
        measured = loaded.measure(p, loaded.readings(60, seed=4), channels, SIGMA, noise)
        measured = change(measured, np.linspace(-0.5, 0.5, 60), loaded.model)
        registered = register(loaded.model, measured)
        found = estimate_parameters(loaded.model, measured, Identify(), registered)
        return summarise(loaded.model, measured, found, registered).findings

    return of


def one_actuator(size: float):
    """The readings of the second actuator fall behind its joint by `size` [m, rad] from first to last."""

    def change(measured, time, model):
        readings = measured.readings.copy()
        readings[:, 1] -= size * time / model.actuators.gain[1]
        return replace(measured, readings=readings)

    return change


@pytest.mark.parametrize(
    "name, channels",
    [
        ("ups3_s", ("tilt", "yaw")),
        ("gough_stewart", ("orientation", "position")),
        ("rps3", ("orientation", "position")),
    ],
)
@pytest.mark.parametrize("size", [1e-4, -3e-4])
def test_a_drift_of_one_actuator_is_named_with_its_size(findings, robot, name, channels, size):
    first, cause = findings(name, channels, one_actuator(size))[:2]
    assert "can't explain the measurements" in first
    actuator = robot(name).chain.actuated_names[1]
    assert cause.startswith("likely cause: a drift of ")
    shown = re.search(rf"{actuator} ([-+.\de]+) mm", cause)
    assert shown is not None
    assert float(shown[1]) == pytest.approx(1e3 * size, rel=0.2)


def test_a_drift_of_the_instrument(findings):
    """Orientations turn about the vertical as the poses go by."""

    def change(measured, time, model):
        angle = np.deg2rad(0.1) * time
        c, s, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 1 + 0 * angle
        turn = np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]), -1, 0)
        values = {"orientation": turn @ measured.values["orientation"]}
        values["position"] = (turn @ measured.values["position"][..., None])[..., 0]
        return measured.replaced(**values)

    cause = findings("gough_stewart", ("orientation", "position"), change)[1]
    assert "a drift of the instrument along the rows" in cause
    assert float(re.search(r"instrument.rz ([-+.\d]+) deg", cause)[1]) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_errors_that_do_not_follow_the_rows_are_no_drift(findings, seed):
    """The same size in random order, and no error at all."""

    def shuffled(measured, time, model):
        return one_actuator(5e-4)(measured, np.random.default_rng(seed).permutation(time), model)

    assert not [f for f in findings("ups3_s", ("tilt", "yaw"), shuffled) if "drift" in f]
    assert not [f for f in findings("ups3_s", ("tilt", "yaw")) if "drift" in f]
