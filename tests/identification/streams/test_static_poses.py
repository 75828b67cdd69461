"""From a log and a command log to poses, on campaigns whose schedule, attitudes and clocks are known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kincal.identification.streams.commands import read_commands
from kincal.identification.streams.static_poses import static_poses
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError

RANDOM = np.random.default_rng(7)
JOINTS = RANDOM.uniform(-0.1, 0.1, (40, 3))
PLANE = np.array([[100.0, 30.0, -50.0], [20.0, -80.0, 60.0]])


def attitudes(joints: np.ndarray) -> np.ndarray:
    """Roll, pitch (n, 2) [rad] that the campaign's robot has, written out again."""
    a, b, c = joints.T
    roll, pitch = 100 * a + 30 * b - 50 * c + 200 * a * b, 20 * a - 80 * b + 60 * c + 200 * b * c
    return np.deg2rad(np.column_stack([roll, pitch]))


def errors(found, joints) -> np.ndarray:
    """(k, 2) [deg] of each kept pose's mean."""
    means = found.stream.groupby("pose")[["roll", "pitch"]].mean()
    return np.rad2deg(means.to_numpy() - attitudes(joints)[means.index])


def begins_after_arrival(found, schedule) -> np.ndarray:
    first = found.stream.groupby("pose")["t"].min()
    return first.to_numpy() - schedule.offset - schedule.arrived[first.index]


@pytest.mark.parametrize("offset", [0.0, 1234.5, -3.2e5, 1.7e9])
@pytest.mark.parametrize("noise_deg", [0.001, 0.05])
def test_every_pose_and_the_offset(campaigns, found, offset, noise_deg):
    """All forty poses, joints as commanded, means as true as the noise allows, none of a move's samples."""
    schedule = campaigns(JOINTS, offset=offset, noise_deg=noise_deg)
    poses = found(schedule)
    assert poses.campaign.kept == poses.campaign.commanded == 40
    assert poses.campaign.dropped == ()
    np.testing.assert_array_equal(poses.table[["a", "b", "c"]], JOINTS)
    assert poses.campaign.offset.seconds == pytest.approx(offset, abs=0.3)
    assert poses.campaign.offset.paired >= 35
    samples = len(poses.stream) / 40
    assert np.sqrt(np.mean(errors(poses, JOINTS) ** 2)) < 1.3 * noise_deg / np.sqrt(samples)
    assert begins_after_arrival(poses, schedule).min() > 0.8
    assert poses.stream.groupby("pose")["t"].agg(np.ptp).min() >= 2.0


@pytest.mark.parametrize("order", ["random", "grid"])
def test_equal_intervals_don_t_mislead(campaigns, found, order):
    """Poses that come like a clock fit at many offsets, their attitudes at one; even where rows of a grid repeat."""
    axis = np.linspace(-0.1, 0.1, 4)
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    schedule = campaigns(grid if order == "grid" else RANDOM.permutation(grid), dwell=(6.0, 6.0))
    changes = np.diff(schedule.commanded)
    assert changes.max() < 9
    poses = found(schedule)
    assert poses.campaign.offset.seconds == pytest.approx(schedule.offset, abs=0.3)
    assert poses.campaign.kept == 64


def test_poses_too_short_are_dropped_with_the_reason(campaigns, found):
    schedule = campaigns(JOINTS, dwell=(0.5, 9.0))
    poses = found(schedule)
    held = np.diff(np.append(schedule.commanded, np.inf)) - (schedule.arrived - schedule.commanded)
    assert poses.campaign.kept + len(poses.campaign.dropped) == 40
    assert {d.pose for d in poses.campaign.dropped} >= set(np.flatnonzero(held < 2.5))
    assert {d.pose for d in poses.campaign.dropped} <= set(np.flatnonzero(held < 5.5))
    assert all("allowed are at least" in d.reason for d in poses.campaign.dropped)
    assert np.abs(errors(poses, JOINTS)).max() < 0.005


def test_a_pose_that_never_comes_to_rest_is_dropped(campaigns, found):
    """One that swings, one that creeps, one whose sensor is stuck and one whose samples are missing; no other."""
    schedule = campaigns(JOINTS)
    log, t = schedule.log, schedule.log["t"] - schedule.offset
    until = np.append(schedule.commanded[1:], np.inf)

    def at(pose: int) -> pd.Series:
        return (t >= schedule.arrived[pose]) & (t < until[pose])

    log.loc[at(5), "roll"] += np.deg2rad(0.5) * np.sin(5 * t[at(5)])
    log.loc[at(11), "pitch"] += np.deg2rad(0.02) * (t[at(11)] - schedule.arrived[11])
    log.loc[at(17), "roll"] = log.loc[at(17), "roll"].iloc[0]
    poses = found(replace(schedule, log=log[(t < schedule.commanded[23]) | (t >= until[23])]))
    reasons = {d.pose: d.reason for d in poses.campaign.dropped}
    assert sorted(reasons) == [5, 11, 17, 23]
    assert "still moving" in reasons[5]
    assert "still moving" in reasons[11]
    assert "no samples" in reasons[23]
    assert poses.campaign.health.stuck["roll"] > 100
    assert np.abs(errors(poses, JOINTS)).max() < 0.005


def test_a_move_that_tilt_can_t_see(campaigns, found):
    """Every second move is about the vertical: without a gyro its travel time is granted, with one it is seen."""
    nowhere = np.cross(PLANE[0], PLANE[1]) * 1e-5  # joints that turn the plane's tilt by nothing
    joints = np.repeat(JOINTS[:20], 2, axis=0)
    joints[:, :2] = 0.05 * np.sign(joints[:, :2])
    joints[1::2] += nowhere
    for gyro in (False, True):
        schedule = campaigns(joints, gyro=gyro)
        poses = found(schedule)
        assert poses.campaign.offset.seconds == pytest.approx(schedule.offset, abs=0.4)
        assert poses.campaign.kept >= 36
        assert begins_after_arrival(poses, schedule).min() > 0.3


def test_set_points_many_times_a_second(campaigns, found, tmp_path):
    """A controller's log at 20 Hz, its trajectories in it: the same targets, numbered as they come."""
    schedule = campaigns(JOINTS)
    poses = found(schedule)
    t = np.arange(97.0, schedule.arrived[-1] + 5, 0.05)
    k = np.maximum(np.searchsorted(schedule.commanded, t, side="right") - 1, 0)
    way = np.clip((t - schedule.commanded[k]) / (schedule.arrived - schedule.commanded)[k], 0, 1)
    way = (way * way * (3 - 2 * way))[:, None]
    before = np.vstack([JOINTS[:1], JOINTS[:-1]])
    points = np.where(way == 1, JOINTS[k], before[k] + (JOINTS[k] - before[k]) * way)
    pd.DataFrame({"t": t, **dict(zip("abc", points.T, strict=True))}).to_csv(tmp_path / "dense.csv", index=False)
    dense = static_poses(Measure(streams=tmp_path / "log.csv", commands=tmp_path / "dense.csv"), ("a", "b", "c"))
    np.testing.assert_array_equal(dense.table, poses.table)
    assert dense.campaign.offset.seconds == pytest.approx(schedule.offset, abs=0.3)


def test_numbers_of_the_command_log(campaigns, found, tmp_path):
    """Poses are called as the commands call them; a number that comes twice names no pose."""
    schedule = campaigns(JOINTS[:10])
    found(schedule)
    pose = np.array([7, 3, 12, 40, 3, 11, 10, 9, 8, 1])
    schedule.commands.assign(pose=pose).to_csv(tmp_path / "commands.csv", index=False)
    numbered = static_poses(Measure(streams=tmp_path / "log.csv", commands=tmp_path / "commands.csv"), ("a", "b", "c"))
    kept = pose != 3
    assert numbered.table["pose"].tolist() == pose[kept].tolist()
    np.testing.assert_array_equal(numbered.table[["a", "b", "c"]], JOINTS[:10][kept])
    assert [(d.pose, d.reason) for d in numbered.campaign.dropped] == [(3, "more than one target has its number")]


def test_a_stated_offset_and_limits(campaigns, found):
    schedule = campaigns(JOINTS[:6])
    log = Log(offset_seconds=schedule.offset, settle_seconds=0.5, min_seconds=1.0, max_seconds=3.0)
    poses = found(schedule, log)
    assert poses.campaign.offset.paired == 0
    assert poses.campaign.kept == 6
    assert poses.stream.groupby("pose")["t"].agg(np.ptp).max() <= 3.0


def test_another_campaign_s_commands_are_refused(campaigns, found):
    """Commands at times that have nothing to do with the motions."""
    schedule = campaigns(JOINTS)
    other = campaigns(JOINTS, seed=5, dwell=(3.0, 30.0))
    schedule.commanded[:] = other.commanded
    with pytest.raises(InputError, match=r"log\.csv: .*(fit|left)"):
        found(schedule)


def test_a_single_motion_can_t_tell_the_offset(campaigns, found):
    with pytest.raises(InputError, match=r"log\.csv: .* needs at least 2 of each: set measure\.log\.offset_seconds"):
        found(campaigns(JOINTS[:2]))


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda c: c.drop(columns="b"), "column 'b' (b) is missing from the command log; it has t, a, c"),
        (lambda c: c.assign(t=c["t"][::-1].to_numpy()), "column 't', row 2: time must increase"),
        (lambda c: c.assign(a=["x", *c["a"][1:]]), "column 'a', row 1: found 'x'; allowed are finite numbers"),
        (lambda c: c.assign(pose=0.5), "column 'pose', row 1: found 0.5; allowed are whole numbers"),
        (lambda c: c[:1], "1 rows; a command log needs at least two"),
    ],
)
def test_bad_command_logs_are_refused(spoil, said, campaigns, tmp_path):
    file = tmp_path / "commands.csv"
    spoil(campaigns(JOINTS[:5]).commands).to_csv(file, index=False)
    with pytest.raises(InputError) as error:
        read_commands(file, ("a", "b", "c"), Measure(streams=file, commands=file))
    assert said in str(error.value)
