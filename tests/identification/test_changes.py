"""Changes between two campaigns of one robot: against many pairs of campaigns, and a change that is known."""

import numpy as np
import pytest
from scipy.stats import kstest

from kincal.identification.changes import changes, same_drawing
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.summary import summarise
from kincal.urdf.description import Identify

SIGMA = {"orientation": np.deg2rad(0.005), "position": 2e-5}


@pytest.fixture
def campaign(robot):
    """campaign(p, seed, estimator): the identification of a robot with parameters p from its own poses and noise."""

    def measure(name: str, p: np.ndarray, seed: int, estimator: str = "map"):
        loaded, noise = robot(name), np.random.default_rng([seed, 17])
        measured = loaded.measure(p, loaded.readings(40, seed), ("orientation", "position"), SIGMA, noise)
        settings = Identify(estimator=estimator)
        registered = register(loaded.model, measured)
        estimate = estimate_parameters(loaded.model, measured, settings, registered)
        return summarise(loaded.model, measured, estimate, registered, settings)

    return measure


def test_a_robot_that_did_not_change(robot, campaign):
    """24 pairs of campaigns of 24 robots: p-values are uniform, single parameters stay within the limit."""
    loaded, values, beyond = robot("ups3_s"), [], 0
    for seed in range(24):
        p = loaded.random_parameters(seed)
        found = changes(campaign("ups3_s", p, 2 * seed), campaign("ups3_s", p, 2 * seed + 1))
        values.append(found.p_value)
        beyond += bool(np.any(np.abs(found.sigmas) > found.limit))
    assert kstest(values, "uniform").pvalue > 1e-3
    assert beyond <= 2


def test_a_known_change_is_found(robot, campaign):
    """A homing switch was moved by 0.2 mm, and the tracker set up anew."""
    loaded = robot("gough_stewart")
    p = loaded.random_parameters(3)
    moved = p.copy()
    zero = loaded.model.parameters.names.index("leg2_slide.zero")
    moved[zero] += 2e-4
    moved[-12:-6] += 0.1
    found = changes(campaign("gough_stewart", p, 1), campaign("gough_stewart", moved, 2))
    assert found.p_value < 1e-6
    assert np.abs(found.sigmas).max() > found.limit
    assert zero in found.likely
    assert {found.names[k].partition("_")[0].partition(".")[0] for k in found.likely} == {"leg2"}
    assert abs(found.change[zero] - 2e-4) < 3 * found.std[zero]


def test_other_drawings_are_not_compared(robot, campaign):
    loaded = robot("ups3_s")
    one = campaign("ups3_s", loaded.random_parameters(1), 1)
    other = campaign("rps3", robot("rps3").random_parameters(1), 1)
    assert same_drawing(one, one)
    assert not same_drawing(one, other)
