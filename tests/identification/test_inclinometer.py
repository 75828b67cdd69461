"""The extended Kalman filter over inclinometer streams, on attitudes that are known."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.inclinometer import filter_stream
from kincal.identification.streams.reading import read_stream
from kincal.pipeline.virtual.robot import stream_of
from kincal.urdf.description import Filter, Measure, Sensor, Stream
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion

SENSOR = Sensor(tilt_deg=0.01, yaw_deg=0.01)
STREAM = Stream(rate_hz=50, seconds=5, outliers=0.01, outlier_deg=2.0, dropouts=0.02)
ANGLES = ("roll", "pitch", "yaw")


def attitudes(n: int, seed: int, centre_deg=(0.0, 0.0, 0.0), spread_deg=(25.0, 25.0, 175.0)) -> np.ndarray:
    """(n, 3) roll, pitch, yaw [deg], uniform about a centre."""
    return np.array(centre_deg) + np.random.default_rng([seed, 3]).uniform(-1, 1, (n, 3)) * spread_deg


def stream(angles_deg: np.ndarray, seed: int, channels=("tilt", "yaw"), stream: Stream = STREAM) -> pd.DataFrame:
    """What the sensors say of attitudes (n, 3)."""
    rotation = Rotation.from_euler("ZYX", angles_deg[:, ::-1], degrees=True).as_matrix()
    return stream_of(Motion(rotation, np.zeros_like(angles_deg)), channels, SENSOR, stream, seed)


def filtered(raw: pd.DataFrame, settings: Filter | None = None) -> pd.DataFrame:
    return filter_stream(raw, raw["pose"].unique(), SENSOR, settings or Filter(), "stream.csv").rows


def apart(found: np.ndarray, true_deg: np.ndarray) -> np.ndarray:
    """Differences of angles [deg], across +-180 degrees as well."""
    return (np.rad2deg(found) - true_deg + 180) % 360 - 180


def sigmas(rows: pd.DataFrame) -> np.ndarray:
    """(n, 3) one sigma of roll, pitch, yaw [deg]."""
    return np.rad2deg(rows[["tilt_std", "tilt_std", "yaw_std"]].to_numpy())


@pytest.fixture(scope="module")
def two_hundred() -> tuple[np.ndarray, pd.DataFrame, pd.DataFrame]:
    """True angles [deg], their raw stream, and what the filter makes of it."""
    true = attitudes(200, seed=1)
    raw = stream(true, seed=1)
    return true, raw, filtered(raw)


def test_intervals_hold_what_they_promise(two_hundred):
    """Against the true attitudes: 95 % intervals hold 92 to 98 %, and errors in sigmas have a spread of one."""
    true, _, rows = two_hundred
    normed = apart(rows[list(ANGLES)].to_numpy(), true) / sigmas(rows)
    inside = np.abs(normed) < 1.959964
    assert 0.92 <= inside[:, :2].mean() <= 0.98
    assert 0.92 <= inside.mean() <= 0.98
    assert np.sqrt(np.mean(normed**2)) == pytest.approx(1.0, abs=0.1)
    assert np.abs(normed.mean(axis=0)).max() < 3 / np.sqrt(len(true))


def test_as_accurate_as_the_mean_of_good_samples(two_hundred):
    """Against the mean of the samples without outliers, which are known here by the truth."""
    true, raw, rows = two_hundred
    samples = apart(raw[list(ANGLES)].to_numpy(), true[raw["pose"]])
    assert 0.005 < np.mean(np.abs(samples) > 1.0) < 0.015  # two degrees of outlier, a hundredth of noise
    means = pd.DataFrame(samples).mask(np.abs(samples) > 1.0).groupby(raw["pose"]).mean().to_numpy()
    errors = apart(rows[list(ANGLES)].to_numpy(), true)
    for k in range(3):
        assert np.sqrt(np.mean(errors[:, k] ** 2)) <= 1.2 * np.sqrt(np.mean(means[:, k] ** 2))


def test_samples_are_counted(two_hundred):
    """Against the outliers that stand in the stream: each is gated, and next to nothing else."""
    true, raw, rows = two_hundred
    wrong = (np.abs(apart(raw[list(ANGLES)].to_numpy(), true[raw["pose"]])) > 1.0).any(axis=1)
    assert wrong.sum() <= rows["gated"].sum() <= wrong.sum() + 0.002 * len(raw)
    assert rows["used"].sum() + rows["gated"].sum() == len(raw)


@pytest.mark.parametrize("centre", [(0, 0, 180), (180, 0, 0), (180, 20, -180)])
def test_across_half_a_turn(centre):
    """Headings about +-180 degrees, and an inclinometer that hangs upside down (roll there): against the truth."""
    true = attitudes(10, seed=2, centre_deg=centre, spread_deg=(0.02, 0.02, 0.02))
    raw = stream(true, seed=2)
    jumping = [name for name, value in zip(ANGLES, centre, strict=True) if abs(value) == 180]
    assert all(np.ptp(raw[name]) > 6 for name in jumping)  # the raw numbers do jump
    rows = filtered(raw)
    errors = apart(rows[list(ANGLES)].to_numpy(), true) / sigmas(rows)
    assert np.abs(errors).max() < 4
    assert (np.abs(rows[list(ANGLES)].to_numpy()) <= np.pi).all()


@pytest.mark.parametrize("first", [1, 3, 5])
@pytest.mark.parametrize("outlier_deg", [2.0, 0.2, 100.0])
def test_outliers_at_the_start_leave_no_bias(first, outlier_deg):
    """Against the same stream without these samples: a filter that starts from one would not agree."""
    raw = stream(attitudes(10, seed=3), seed=3, stream=STREAM.model_copy(update={"seconds": 2.0, "outliers": 0.0}))
    number = raw.groupby("pose").cumcount()
    spoiled = raw.copy()
    spoiled.loc[number < first, list(ANGLES)] += np.deg2rad(outlier_deg)
    rows, clean = filtered(spoiled), filtered(raw[number >= first])
    difference = apart(rows[list(ANGLES)].to_numpy(), np.rad2deg(clean[list(ANGLES)].to_numpy())) / sigmas(clean)
    assert np.abs(difference).max() < 0.5
    assert np.abs(difference.mean(axis=0)).max() < 0.1
    assert (rows["gated"] >= first).all()


@pytest.mark.parametrize("spoiled, other", [(["yaw"], ["roll", "pitch", "tilt_std"]), (["roll"], ["yaw", "yaw_std"])])
def test_outliers_of_one_sensor_cost_the_other_nothing(spoiled, other):
    """Against the same stream without the outliers of the other sensor."""
    clean = stream(attitudes(5, seed=4), seed=4)
    raw = clean.copy()
    hit = np.random.default_rng(0).random(len(raw)) < 0.3
    raw.loc[hit, spoiled] += np.deg2rad(2.0)
    rows, expected = filtered(raw), filtered(clean)
    np.testing.assert_allclose(rows[other], expected[other], rtol=0, atol=1e-13)
    assert rows["gated"].sum() > 0.25 * len(raw)


def test_a_gap_costs_only_its_samples():
    """Against the statistics of the mean: two seconds of five missing, sigmas grow by the root of 5 / 3."""
    raw = stream(attitudes(10, seed=5), seed=5)
    since = raw["t"] - raw.groupby("pose")["t"].transform("min")
    whole, gappy = filtered(raw), filtered(raw[(since < 1.5) | (since > 3.5)])
    ratio = gappy["tilt_std"].to_numpy() / whole["tilt_std"].to_numpy()
    np.testing.assert_allclose(ratio, np.sqrt(5 / 3), rtol=0.04)
    assert np.abs(gappy["roll"] - whole["roll"]).max() < 4 * gappy["tilt_std"].max()


def test_order_of_the_poses_asked_for():
    """Rows come as asked for, each one the same as if it were alone: poses know nothing of each other."""
    raw = stream(attitudes(6, seed=6), seed=6)
    rows = filter_stream(raw, np.array([4, 1]), SENSOR, Filter(), "stream.csv").rows
    assert rows["pose"].tolist() == [4, 1]
    alone = filtered(raw[raw["pose"] == 1])
    assert rows.iloc[1].to_dict() == alone.iloc[0].to_dict()


def test_without_a_heading():
    """Tilt alone: no column of yaw is invented, and the tilt is the same as with a heading."""
    raw = stream(attitudes(5, seed=7), seed=7)
    rows, both = filtered(raw.drop(columns="yaw")), filtered(raw)
    assert not {"yaw", "yaw_std"} & set(rows)
    np.testing.assert_allclose(rows[["roll", "pitch", "tilt_std"]], both[["roll", "pitch", "tilt_std"]], atol=1e-13)


# Files and refusals


@pytest.fixture
def raw() -> pd.DataFrame:
    """Three poses of a second each."""
    return stream(attitudes(3, seed=8), seed=8, stream=STREAM.model_copy(update={"seconds": 1.0, "outliers": 0.0}))


def test_column_map_and_degrees(raw, tmp_path):
    """A foreign file (names, degrees, semicolons, decimal commas) against the same stream as kincal writes it."""
    foreign = pd.DataFrame({"Zeit": raw["t"], "Lage": raw["pose"], "X": np.rad2deg(raw["roll"])})
    foreign = foreign.assign(Y=np.rad2deg(raw["pitch"]), yaw=raw["yaw"])
    foreign.to_csv(tmp_path / "foreign.csv", sep=";", decimal=",", index=False)
    degrees = {"roll": {"from": "X", "unit": "deg"}, "pitch": {"from": "Y", "unit": "deg"}}
    measure = Measure(separator=";", decimal=",", columns={"t": "Zeit", "pose": "Lage", **degrees})
    found, health = read_stream(tmp_path / "foreign.csv", measure)
    assert health.lines() == ()
    pd.testing.assert_frame_equal(found, raw, check_dtype=False, rtol=1e-12)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_what_was_written_is_read(raw, tmp_path, suffix):
    """The canonical stream in both formats, to the last bit."""
    file = tmp_path / f"stream.{suffix}"
    raw.to_csv(file, index=False) if suffix == "csv" else raw.to_parquet(file)
    found, health = read_stream(file, Measure())
    pd.testing.assert_frame_equal(found, raw, check_dtype=False, check_exact=True)
    assert health.lines() == ()


def refused(raw: pd.DataFrame, tmp_path, *said: str, poses=(0, 1, 2), settings: Filter | None = None) -> None:
    """Reading or filtering the stream ends in one line that says each of these."""
    file = tmp_path / "stream.csv"
    raw.to_csv(file, index=False)

    def read_and_filter() -> None:
        filter_stream(read_stream(file, Measure())[0], np.array(poses), SENSOR, settings or Filter(), str(file))

    with pytest.raises(InputError) as error:
        read_and_filter()
    assert "\n" not in str(error.value)
    for text in ("stream.csv", *said):
        assert text in str(error.value)


def left_out(raw: pd.DataFrame, pose: int, reason: str, settings: Filter | None = None) -> None:
    """One pose of three is dropped with a reason, the others are as in a stream without it to the last bit."""
    found = filter_stream(raw, np.arange(3), SENSOR, settings or Filter(), "stream.csv")
    assert [d.pose for d in found.dropped] == [pose]
    assert re.fullmatch(reason, found.dropped[0].reason)
    pd.testing.assert_frame_equal(found.rows, filtered(raw[raw["pose"] != pose], settings), check_exact=True)


def test_a_pose_without_samples_is_left_out(raw):
    left_out(raw[raw["pose"] != 1], 1, "it has no sample; allowed is at least 5")


@pytest.mark.parametrize("channel", ANGLES)
def test_a_pose_with_a_stuck_channel_is_left_out(raw, channel):
    raw.loc[raw["pose"] == 2, channel] = np.deg2rad(3.25)
    left_out(raw, 2, rf"channel '{channel}' is stuck at 3\.25 degrees for all {sum(raw['pose'] == 2)} samples")


def test_too_few_samples_are_left_out(raw):
    few = raw[(raw["pose"] != 1) | (raw.groupby("pose").cumcount() < 4)]
    left_out(few, 1, "it has 4 samples; allowed is at least 5")
    left_out(few, 1, "it has 4 samples; allowed is at least 30", settings=Filter(min_samples=30))


def test_samples_that_never_agree_are_left_out(raw):
    """A sensor in a shaken pose: samples over forty degrees have no attitude."""
    shaken = raw["pose"] == 1
    raw.loc[shaken, ["roll", "pitch"]] = np.random.default_rng(0).uniform(-0.35, 0.35, (shaken.sum(), 2))
    left_out(raw, 1, rf"\d+ of {shaken.sum()} samples are outliers; .*")


@pytest.mark.parametrize("seed", range(2))
def test_mostly_outliers_are_left_out(raw, seed):
    """Four samples of five are 2 degrees off, up or down: which of the three is the attitude, nobody can tell."""
    random = np.random.default_rng(seed)
    wrong = (raw["pose"] == 1) & (random.random(len(raw)) < 0.8)
    raw.loc[wrong, "roll"] += np.deg2rad(2.0) * random.choice([-1.0, 1.0], wrong.sum())
    left_out(raw, 1, r"\d+ of \d+ samples are outliers; .*")


def test_the_noise_is_not_that_of_poses_left_out(raw):
    """Where nobody gave a sample's sigma it comes from the samples: those of a stuck pose have none."""
    raw.loc[raw["pose"] == 2, "roll"] = 0.5
    found = filter_stream(raw, np.arange(3), Sensor(), Filter(), "stream.csv")
    clean = filter_stream(raw[raw["pose"] != 2], np.arange(2), Sensor(), Filter(), "stream.csv")
    pd.testing.assert_frame_equal(found.rows, clean.rows, check_exact=True)


def test_a_heading_that_nothing_is_behind_is_left_out(raw):
    """Of an instrument without a compass, which says 0: against the stream without that channel."""
    found = filter_stream(raw.assign(yaw=0.0), np.arange(3), SENSOR, Filter(), "stream.csv")
    assert (found.dropped, found.yaw_stuck) == ((), 3)
    pd.testing.assert_frame_equal(found.rows, filtered(raw.drop(columns="yaw")), check_exact=True)


def test_half_of_the_poses_left_out_are_refused(raw, tmp_path):
    refused(raw[raw["pose"] == 1], tmp_path, "2 of 3 poses", "fewer than half", "pose 0: it has no sample")
    refused(raw, tmp_path, "2 of 4 poses", "pose 7", poses=(0, 1, 7, 9))
    stuck = raw.assign(roll=raw["roll"].mask(raw["pose"] > 0, 0.5))
    refused(stuck, tmp_path, "2 of 3 poses", "pose 1: channel 'roll' is stuck")
    refused(raw[raw["pose"] == 1].assign(roll=0.5), tmp_path, "1 of 1 poses", "stuck", poses=(1,))


@pytest.mark.parametrize("column", ["t", "pose", "roll", "pitch"])
def test_a_missing_column_is_refused(raw, tmp_path, column):
    refused(raw.drop(columns=column), tmp_path, repr(column), "missing")


def test_an_empty_stream_is_refused(raw, tmp_path):
    refused(raw[:0], tmp_path, "0 of 0 records are good samples")
