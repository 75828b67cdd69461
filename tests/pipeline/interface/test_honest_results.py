"""A result says how far it can be trusted: coverage of the workspace, poses that were used, virtual robots."""

import logging

import numpy as np
import pandas as pd
import pytest

import kincal
from benchmarks.small import SMALL
from kincal.pipeline.report.verdict import verdict
from kincal.urdf.description import Limits

QUICK = (*SMALL, "plan.poses=24")


@pytest.fixture(scope="module")
def robot():
    return kincal.load("ups3_s", QUICK)


@pytest.fixture(scope="module")
def data(robot):
    return kincal.measure(robot, seed=4)


@pytest.fixture(scope="module")
def calibration(robot, data, tmp_path_factory):
    return kincal.calibrate(robot, data, store=tmp_path_factory.mktemp("store"))


@pytest.mark.parametrize("name", ["ups3_s", "linear_delta"])
def test_poses_in_a_corner_do_not_cover_the_workspace(name):
    """The poses nearest to one of them, against as many all over the workspace."""
    robot = kincal.load(name, ["plan.poses=150"])
    table = kincal.measure(robot, seed=11)
    joints = table[list(robot.description.actuated)].to_numpy()
    far = np.linalg.norm((joints - joints[0]) / np.ptp(joints, axis=0), axis=1)
    corner = kincal.identify(robot, table.iloc[np.argsort(far)[:24]])
    spread = kincal.identify(robot, table.sample(24, random_state=1))
    assert any("do not cover [workspace]" in finding for finding in corner.findings)
    assert not any("do not cover" in finding for finding in spread.findings)


def test_poses_that_were_used_are_named(calibration, data, caplog):
    with caplog.at_level(logging.WARNING, "kincal"):
        calibration.evaluate(
            pd.concat([data.head(5), data.tail(4).assign(pose=[90, 91, 92, 93], qw=1.0, qx=0, qy=0, qz=0)])
        )
    assert "5 of 9 poses were used for the calibration" in caplog.text


def test_the_same_commands_on_another_day_are_no_repetition(calibration, robot, caplog):
    with caplog.at_level(logging.WARNING, "kincal"):
        calibration.evaluate(kincal.measure(robot, seed=5))
    assert caplog.text == ""


def test_a_calibration_that_helps_nowhere(calibration, data):
    """Measured is what the nominal robot predicts."""
    assert not calibration.evaluation(data).helps_nowhere
    as_drawn = calibration.predict(data, method="nominal")
    joints = data[["pose", *calibration.robot.description.actuated]]
    assert calibration.evaluation(joints.merge(as_drawn, on="pose")).helps_nowhere


def test_a_pose_outside_the_workspace_is_named(calibration, caplog):
    """The workspace of ups3_s turns by less than 12 degrees about x."""
    low, high = calibration.robot.description.workspace.rotation_deg["x"]
    angles = np.deg2rad([0.0, 0.5 * high, 1.2 * high, 1.2 * low])
    desired = pd.DataFrame({"rx": angles, "ry": 0.0, "rz": 0.0})
    with caplog.at_level(logging.WARNING, "kincal"):
        commands = calibration.compensate(desired)
    assert commands["reached"].all()
    assert "poses 2, 3 are outside [workspace]" in caplog.text


def test_a_verdict_counts_its_poses_and_names_a_virtual_robot(calibration, robot):
    limits = Limits(mean_deg=1.0)
    measured = verdict(limits, calibration.comparison, "geometric")
    assert measured is not None
    assert measured.line.startswith(
        f"PASS: geometric, {calibration.comparison.n_held_out} held-out poses as measured: "
    )
    assert 0 < calibration.comparison.n_held_out < 24
    simulated = verdict(limits, kincal.calibrate(robot).comparison, "geometric")
    assert simulated is not None
    assert simulated.line.startswith("PASS (virtual robot): geometric, ")


def test_a_virtual_robot_does_not_replace_one_that_was_measured(calibration, robot, tmp_path):
    calibration.export(tmp_path / "made")
    simulated = kincal.Calibration.open(robot)
    with pytest.raises(kincal.InputError, match="calibrated from measurements, and this one is virtual"):
        simulated.export(tmp_path / "made")
    simulated.export(tmp_path / "made", force=True)
    assert "VIRTUAL" in (tmp_path / "made" / "robot.toml").read_text()
    assert kincal.measure(robot, seed=1).attrs["virtual"]
