"""One mistake at a time, on a serial arm, a robot of frame loops and a parallel one: each is named by its own words."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.diagnosis import explained, screened
from kincal.identification.likely_causes import likely_causes, misfit
from kincal.identification.measurements import Measurements
from kincal.urdf.errors import InputError, MovedFarError

ROBOTS = ("ur10", "ups3_frame", "rps3")
SIGMA = {"orientation": 1e-5, "position": 1e-5}
CHANNELS = ("orientation", "position")
N = 30


@pytest.fixture(scope="module", params=ROBOTS)
def campaign(request, robot):
    """(robot, its good measurements)"""
    loaded, seed = robot(request.param), 11
    noise = np.random.default_rng([seed, 5])
    p = loaded.random_parameters(seed, 0.7)
    return loaded, loaded.measure(p, loaded.readings(N, seed), CHANNELS, SIGMA, noise)


def refused(loaded, measured: Measurements) -> str:
    with pytest.raises(InputError) as caught:
        screened(loaded.model, measured, reject_outliers=False)
    return str(caught.value)


def turned(m: Measurements, rows, rotation: Rotation) -> Measurements:
    values = m.values["orientation"].copy()
    values[rows] = values[rows] @ rotation.as_matrix()
    return m.replaced(orientation=values)


def shifted(m: Measurements, rows, by) -> Measurements:
    values = m.values["position"].copy()
    values[rows] += by
    return m.replaced(position=values)


def of_rows(m: Measurements, joints, measured) -> Measurements:
    """The joints of some rows with the measurements of others."""
    return replace(m[np.asarray(joints)], values={c: v[np.asarray(measured)] for c, v in m.values.items()})


def read_as(m: Measurements, written: np.ndarray) -> Measurements:
    """The angles that somebody wrote, (n, 3), read as kincal reads rx, ry, rz."""
    return m.replaced(orientation=Rotation.from_euler("XYZ", written).as_matrix())


# Of some rows


def test_a_wrong_pose_is_named_alone(campaign):
    loaded, good = campaign
    message = refused(loaded, turned(good, 7, Rotation.from_rotvec([0.0, 0.004, 0.0])))
    assert "likely cause: pose 7 does not fit the others; measure.skip leaves poses out" in message


def test_a_fifth_of_the_poses_may_be_wrong_and_is_left_out(campaign):
    loaded, good = campaign
    wrong = np.array([2, 9, 13, 17, 22, 28])
    screening = screened(loaded.model, turned(good, wrong, Rotation.from_rotvec([0.0, 0.0, np.pi])))
    assert np.flatnonzero(~screening.kept).tolist() == wrong.tolist()
    assert screening.finding.startswith("6 of 30 poses are left out: poses 2, 9, 13, 17, 22, 28 do not fit the others")
    assert "identify.loss = 'huber'" in screening.finding
    np.testing.assert_allclose(screening.misfit, misfit(loaded.model, good[screening.kept]), rtol=0.3)


def test_good_poses_are_kept(campaign):
    loaded, good = campaign
    screening = screened(loaded.model, good)
    assert screening.kept.all()
    assert screening.finding == ""


def test_a_target_that_was_not_seen(campaign):
    loaded, good = campaign
    values = {c: v.copy() for c, v in good.values.items()}
    for k in (4, 20):
        values["orientation"][k], values["position"][k] = np.eye(3), 0.0
    assert "poses 4, 20 hold zeros: the target was not seen there" in refused(loaded, good.replaced(**values))


def test_rows_that_repeat_the_row_before(campaign):
    loaded, good = campaign
    rows = np.arange(N)
    rows[[12, 13]] = 11
    message = refused(loaded, of_rows(good, np.arange(N), rows))
    assert "poses 12, 13 repeat the measurement of the row before" in message


@pytest.mark.parametrize("late", [1, -2])
def test_rows_late(campaign, late):
    loaded, good = campaign
    joints = np.arange(max(late, 0), N + min(late, 0))
    words = f"{abs(late)} row{'s' * (abs(late) > 1)} {'late' if late > 0 else 'early'}"
    message = refused(loaded, of_rows(good, joints, joints - late))
    assert message.endswith(f"likely cause: the measured columns are {words} against the joints")


def test_a_row_that_was_lost(campaign):
    loaded, good = campaign
    rows = np.arange(N - 1)
    message = refused(loaded, of_rows(good, rows, rows + (rows >= 12)))
    assert message.endswith("likely cause: from pose 12 on the measured columns are 1 row early against the joints")


def test_an_encoder_that_is_stuck(campaign):
    loaded, good = campaign
    name, readings = loaded.chain.actuated_names[1], good.readings.copy()
    readings[22:, 1] = readings[22, 1]
    message = refused(loaded, replace(good, readings=readings))
    assert message.endswith(f"the reading of {name} is stuck from pose 23 on, at 7 poses, while the robot moves")


def test_an_instrument_or_a_target_that_moved(campaign):
    loaded, good = campaign
    move = Rotation.from_rotvec([0.004, -0.003, 0.005]).as_matrix()
    orientation, position = (good.values[c].copy() for c in CHANNELS)
    orientation[17:], position[17:] = move @ orientation[17:], position[17:] @ move.T + [0.002, 0.001, -0.003]
    message = refused(loaded, good.replaced(orientation=orientation, position=position))
    assert re.search(r"likely cause: the instrument moved between poses 16 and 17 \([\d.]+ mm, 0\.4\d* deg\)$", message)
    orientation, position = (good.values[c].copy() for c in CHANNELS)
    position[17:] += orientation[17:] @ [0.003, -0.002, 0.001]
    orientation[17:] = orientation[17:] @ move
    message = refused(loaded, good.replaced(orientation=orientation, position=position))
    assert re.search(r"likely cause: the target moved between poses 16 and 17 \([\d.]+ mm, 0\.4\d* deg\)$", message)


def test_a_drift_is_no_reason_to_refuse_but_is_known(campaign):
    loaded, good = campaign
    readings, j = good.readings.copy(), 0
    slides = loaded.chain.prismatic[loaded.chain.actuated[j]]
    readings[:, j] += np.linspace(0, 0.003 if slides else 0.01, N)
    drifting = replace(good, readings=readings)
    assert screened(loaded.model, drifting).kept.all()
    causes = str(likely_causes(loaded.model, drifting, misfit(loaded.model, drifting)))
    size = re.search(rf"a drift of {loaded.chain.actuated_names[j]} along the rows \(([-+.\d]+) (mm|deg) from", causes)
    assert size is not None, causes
    assert float(size[1]) == pytest.approx(-3.0 if slides else -np.rad2deg(0.01), rel=0.01)


def test_backlash_and_settling_of_one_joint(campaign):
    loaded, good = campaign
    j, name = 1, loaded.chain.actuated_names[1]
    slides = loaded.chain.prismatic[loaded.chain.actuated[j]]
    size, unit, factor = (3e-4, "mm", 1e3) if slides else (2e-3, "deg", 180 / np.pi)
    direction = np.sign(np.diff(good.readings[:, j], prepend=good.readings[0, j]))
    laws = {
        "backlash": (0.5 * direction, "between the directions of approach"),
        "settling": (np.exp(-np.arange(N) / 0.15 / (N - 1)), "at the first pose"),
    }
    for law, (profile, behind) in laws.items():
        readings = good.readings.copy()
        readings[:, j] -= size * profile
        measured = replace(good, readings=readings)
        causes = str(likely_causes(loaded.model, measured, misfit(loaded.model, measured)))
        told = re.search(rf"{law} of {name} \(\+([\d.]+) {unit} {behind}\)", causes)
        assert told is not None, causes
        assert float(told[1]) == pytest.approx(size * factor, rel=0.05)
        assert screened(loaded.model, measured).kept.all()  # the fit goes on


# Of all rows


def test_a_rotation_vector_and_other_orders(campaign):
    loaded, good = campaign
    rotation = Rotation.from_matrix(good.values["orientation"])
    cases = {"measure.rotation_vector = true": rotation.as_rotvec()}
    for order in ("ZYX", "YXZ"):
        by_axis = rotation.as_euler(order)[:, [order.index(axis) for axis in "XYZ"]]
        cases[f'measure.euler = "{order}"'] = by_axis
    cases['measure.euler = "ZYZ", columns euler_1'] = rotation.as_euler("ZYZ")
    for cure, written in cases.items():
        assert cure in refused(loaded, read_as(good, written))


@pytest.mark.parametrize("unit, factor", [("millimetres", 1e3), ("centimetres", 1e2), ("inches", 1 / 0.0254)])
def test_another_unit_of_positions(campaign, unit, factor):
    loaded, good = campaign
    message = refused(loaded, good.replaced(position=factor * good.values["position"]))
    assert f"x, y, z are in {unit}, not metres" in message
    # the joint of ups3_frame's platform stands still: a short arm's path is small in any unit
    assert (", or " in message) == (loaded.description.name == "ups3_frame" and unit != "millimetres")


def test_a_scale_that_all_actuators_share(campaign):
    loaded, good = campaign
    scaled = replace(good, readings=1.03 * good.readings)
    assert "all actuators have one wrong scale" in str(
        likely_causes(loaded.model, scaled, misfit(loaded.model, scaled))
    )


def test_a_sign_and_a_zero_of_one_joint(campaign):
    loaded, good = campaign
    name, readings = loaded.chain.actuated_names[2], good.readings.copy()
    readings[:, 2] += 0.02
    elsewhere = replace(good, readings=readings)
    causes = likely_causes(loaded.model, elsewhere, misfit(loaded.model, elsewhere), 1.5)
    assert f"{name} has another zero (actuator.{name}.zero)" in str(causes)
    readings[:, 2] = -good.readings[:, 2]
    message = str(likely_causes(loaded.model, replace(good, readings=readings), np.inf))
    assert re.match(rf"{name} counts the other way round", message)


def test_columns_that_are_copies(campaign):
    loaded, good = campaign
    position = good.values["position"].copy()
    position[:, 1] = position[:, 2]
    message = refused(loaded, good.replaced(position=position))
    assert message.endswith("the columns y and z hold the same values at every pose: one is a copy")


# Of the settings


def test_sigmas_that_are_too_small(campaign):
    """The true ones are a hundred times larger: where a fit is refused, they are to blame."""
    loaded, good = campaign
    noise = np.random.default_rng(4)
    p = loaded.random_parameters(11, 0.7)
    sigma = {c: 100 * s for c, s in SIGMA.items()}
    measured = loaded.measure(p, good.readings, CHANNELS, sigma, noise).scaled(dict.fromkeys(CHANNELS, 0.01))
    error = explained(loaded.model, measured, MovedFarError("a.x moved; check its place", "a.x moved"))
    times = re.search(r"likely cause: the sigmas of \[sensor\] are too small: (\d+) times larger", str(error))
    assert times is not None, str(error)
    assert 80 < float(times[1]) < 125
    assert "check its place" not in str(error)
