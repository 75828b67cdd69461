"""Angles of a stream in degrees that are read as radians, and the other way round: named by the robot as drawn."""

import numpy as np
import pandas as pd
import pytest

from kincal.identification.streams.angle_units import check_units
from kincal.identification.streams.static_poses import static_poses
from kincal.urdf.description import Column, Measure
from kincal.urdf.errors import InputError

ROBOTS = ("ups3_s", "rps3", "ur10", "gough_stewart")  # loops of points, of hinges, none, six legs
ALL = ("roll", "pitch", "yaw")


def campaign(robot, seed, scale, names=ALL):
    """Samples of 20 poses of a robot near its drawing, angles as its instrument writes them: times `scale`."""
    readings = robot.readings(20, seed)
    measured = robot.measure(robot.random_parameters(seed), readings, ("tilt", "yaw"))
    angles = dict(zip(ALL, [*measured.values["tilt"].T, measured.values["yaw"]], strict=True))
    noise = np.random.default_rng(seed).normal(size=(len(names), 100)) * 1e-4
    samples = {n: scale.get(n, 1.0) * (np.repeat(angles[n], 5) + e) for n, e in zip(names, noise, strict=True)}
    table = pd.DataFrame({"pose": np.arange(20)} | dict(zip(robot.chain.actuated_names, readings.T, strict=True)))
    return pd.DataFrame({"t": np.arange(100.0), "pose": np.repeat(np.arange(20), 5), **samples}), table


def check(robot, stream, table, columns=None, form="csv"):
    settings = {"streams": "log.csv", "table": "joints.csv", "columns": columns or {}}
    check_units(stream, table, robot.model, Measure.model_validate(settings), form)


@pytest.mark.parametrize("names", [ALL, ALL[:2]])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_in_radians_passes(name, names, robot):
    for seed in range(3):
        check(robot(name), *campaign(robot(name), seed, {}, names))


@pytest.mark.parametrize(("names", "wrong"), [(ALL, ALL), (ALL[:2], ALL[:2]), (ALL, ALL[:2]), (ALL, ALL[2:])])
@pytest.mark.parametrize("name", ROBOTS)
def test_degrees_are_named(name, names, wrong, robot):
    """And the setting that cures it, which then passes."""
    for seed in range(3):
        stream, table = campaign(robot(name), seed, dict.fromkeys(wrong, 180 / np.pi), names)
        with pytest.raises(InputError) as error:
            check(robot(name), stream, table)
        assert f"log.csv: {', '.join(wrong)}: the robot as drawn fits these angles as degrees" in str(error.value)
        settings = ", ".join(f'{n} = {{ from = "{n}", unit = "deg" }}' for n in wrong)
        assert str(error.value).endswith(f"In measure.columns set {settings}")
        cured = stream.assign(**{n: stream[n] * np.pi / 180 for n in wrong})
        check(robot(name), cured, table, {n: {"from": n, "unit": "deg"} for n in wrong})


@pytest.mark.parametrize("name", ROBOTS[:3])
def test_radians_that_are_declared_degrees(name, robot):
    stream, table = campaign(robot(name), 5, dict.fromkeys(ALL, np.pi / 180))
    columns = {n: Column.model_validate({"from": n.upper(), "unit": "deg"}) for n in ALL}
    with pytest.raises(InputError, match=r'as radians, not as degrees .* set roll = \{ from = "ROLL", unit = "rad" \}'):
        check(robot(name), stream, table, columns)


@pytest.mark.parametrize("name", ROBOTS[:3])
def test_other_mistakes_are_not_named_so(name, robot):
    """Poses in another order, joints swapped, noise alone, too few poses, joint values of no pose: nothing is said."""
    stream, table = campaign(robot(name), 6, {})
    joints = list(robot(name).chain.actuated_names)
    check(robot(name), stream, table.assign(pose=np.roll(table["pose"], 3)))
    check(robot(name), stream, table.assign(**{joints[0]: table[joints[1]], joints[1]: table[joints[0]]}))
    random = np.random.default_rng(1)
    check(robot(name), stream.assign(**{n: random.uniform(-3, 3, 100) for n in ALL}), table)
    check(robot(name), stream.assign(yaw=random.uniform(-3, 3, 100)), table)
    degrees, _ = campaign(robot(name), 6, dict.fromkeys(ALL, 180 / np.pi))
    check(robot(name), degrees, table[:7])
    check(robot(name), degrees, table.assign(**{joints[0]: 1e3}))
    check(robot(name), degrees, table, form="nmea")


def test_a_channel_that_nothing_explains(robot):
    """A heading at random beside a tilt in degrees: the tilt is named alone."""
    stream, table = campaign(robot("rps3"), 6, dict.fromkeys(ALL, 180 / np.pi))
    stream["yaw"] = np.random.default_rng(2).uniform(-3, 3, 100)
    with pytest.raises(
        InputError, match=r"log\.csv: roll, pitch: .* as degrees, .*; kincal cannot decide it for yaw\)"
    ):
        check(robot("rps3"), stream, table)


def test_the_columns_of_a_bag(robot):
    stream, table = campaign(robot("ups3_s"), 7, dict.fromkeys(ALL, 180 / np.pi))
    with pytest.raises(InputError, match=r'roll = \{ from = "x", unit = "deg" \}, pitch = \{ from = "y"'):
        check(robot("ups3_s"), stream, table, form="bag")


@pytest.mark.parametrize("size", [0.3, 1.0, 3.0])
def test_poses_of_a_log_in_degrees(size, campaigns, tmp_path):
    """They are the same as those in radians: no turn of 2 pi is taken off what is in degrees."""
    joints = size * np.random.default_rng(2).uniform(-0.1, 0.1, (14, 3))
    schedule = campaigns(joints, dwell=(6.0, 6.5))
    schedule.commands.to_csv(tmp_path / "commands.csv", index=False)
    measure = Measure(streams=tmp_path / "log.csv", commands=tmp_path / "commands.csv")
    both = []
    for factor in (1.0, 180 / np.pi):
        table = schedule.log.assign(roll=factor * schedule.log["roll"], pitch=factor * schedule.log["pitch"])
        table.to_csv(tmp_path / "log.csv", index=False)
        both.append(static_poses(measure, ("a", "b", "c")))
    assert both[0].campaign.offset.seconds == pytest.approx(both[1].campaign.offset.seconds, abs=1e-6)
    assert both[0].campaign.kept == both[1].campaign.kept == 14
    pd.testing.assert_series_equal(both[0].stream["t"], both[1].stream["t"])
