"""Rows of several topics on one axis of time, as tools that plot logs write them: blank where a topic has no value."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kincal.identification.streams.commands import read_commands
from kincal.identification.streams.health import Tally
from kincal.identification.streams.reading import read_log
from kincal.identification.streams.static_poses import static_poses
from kincal.identification.streams.topics import Topics
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError

JOINTS = ("a", "b", "c")
RANDOM = np.random.default_rng(11)


def topic(rate, *columns, seconds=20.0, shift=0.0):
    """Noise about a slow wave, at times of its own."""
    t = np.round(np.arange(shift, seconds, 1 / rate), 6)
    return pd.DataFrame({"t": t} | {c: 0.1 * np.sin(t) + 1e-3 * RANDOM.normal(size=len(t)) for c in columns})


def merged(*topics):
    return pd.concat(topics).sort_values("t", kind="stable").reset_index(drop=True)


def logged(table, folder, form):
    file = folder / f"log.{form}"
    table.to_parquet(file) if form == "parquet" else table.to_csv(file, index=False)
    return read_log(file, Measure(streams=file, table=folder / "joints.csv"))


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_rows_of_other_topics_are_no_faults(form, tmp_path):
    """Two and more rows in three hold no attitude: it is read as if it stood alone; a note counts the others."""
    attitude = topic(10, "roll", "pitch", "yaw")
    table = merged(attitude, topic(25, "temperature", shift=0.003), topic(5, "voltage", shift=0.007))
    samples, health = logged(table, tmp_path, form)
    np.testing.assert_allclose(samples, attitude, atol=1e-12)
    assert (health.read, health.samples, health.other, health.bad) == (len(table), 200, len(table) - 200, 0)
    assert health.lines() == (
        f"{health.other} of {health.read} rows have blank cells in roll and pitch; they are skipped",
    )


def test_a_heading_in_rows_of_its_own(tmp_path):
    """Each attitude has the heading since the one before, as a sentence of NMEA has."""
    attitude, heading = topic(10, "roll", "pitch"), topic(10, "yaw", shift=0.04)
    samples, health = logged(merged(attitude, heading), tmp_path, "csv")
    np.testing.assert_allclose(samples[["t", "roll", "pitch"]], attitude[1:], atol=1e-12)
    np.testing.assert_allclose(samples["yaw"], heading["yaw"][:199], atol=1e-12)
    assert health.bad == 0


@pytest.mark.parametrize(("roll", "pitch"), [(10, 10), (40, 10), (10, 15)])
def test_roll_and_pitch_in_rows_of_their_own(roll, pitch, tmp_path):
    first, second = topic(roll, "roll"), topic(pitch, "pitch", shift=0.011)
    samples, health = logged(merged(first, second), tmp_path, "csv")
    assert len(samples) == pytest.approx(200, abs=1)
    assert health.bad <= 1
    at = np.searchsorted(first["t"], samples["t"], side="right") - 1
    np.testing.assert_array_equal(samples["roll"], first["roll"].to_numpy()[at])
    assert set(samples["pitch"]) <= set(second["pitch"])
    assert "are in separate rows" in health.lines()[0]


def test_faults_stay_faults(tmp_path):
    """Words, infinite numbers and half an attitude are counted; a value of long ago is none."""
    attitude = topic(10, "roll", "pitch").astype(object)
    attitude.loc[3, "roll"], attitude.loc[4, ["roll", "pitch"]], attitude.loc[5, "pitch"] = "error", "ERR", np.nan
    attitude.loc[6, "roll"] = np.inf
    heading = topic(10, "yaw", shift=0.04)
    table = merged(attitude, heading, pd.DataFrame({"t": [30.0], "roll": [0.1], "pitch": [0.2]}))
    samples, health = logged(table, tmp_path, "csv")
    assert (health.not_finite, health.other) == (4, 200)
    assert samples["t"].max() < 30.0  # its heading was 10 s before


def test_poses_of_a_merged_log(campaigns, tmp_path):
    """The robot's and the sensor's topics in one file: it is the stream and the command log."""
    joints = RANDOM.uniform(-0.1, 0.1, (12, 3))
    schedule = campaigns(joints, offset=0.0, dwell=(6.0, 7.0))
    t = np.arange(100.0, schedule.log["t"].max(), 0.25)
    points = pd.DataFrame(joints, columns=list(JOINTS)).iloc[np.searchsorted(schedule.commanded, t, side="right") - 1]
    separate = [pd.DataFrame({"t": t + 1e-3 * k, name: points[name].to_numpy()}) for k, name in enumerate(JOINTS)]
    other = topic(3, "temperature", seconds=200.0)
    for commands in ([schedule.commands], separate):
        merged(schedule.log, other, *commands).to_csv(tmp_path / "log.csv", index=False)
        measure = Measure(streams=tmp_path / "log.csv", commands=tmp_path / "log.csv")
        poses = static_poses(measure, JOINTS)
        assert poses.campaign.kept == poses.campaign.commanded == 12
        np.testing.assert_array_equal(poses.table[list(JOINTS)], joints)


def test_a_slow_heading_is_named(campaigns, found):
    """Most samples are without it: it is left out, with a warning."""
    schedule = campaigns(RANDOM.uniform(-0.1, 0.1, (8, 3)), dwell=(6.0, 7.0))
    log = schedule.log.assign(yaw=RANDOM.normal(size=len(schedule.log)))
    log.loc[log.index % 5 > 0, "yaw"] = np.nan
    poses = found(replace(schedule, log=log))
    assert "yaw" not in poses.stream
    assert poses.campaign.health.lines() == ("channel 'yaw' is left out: too many samples lack it",)
    assert found(schedule).campaign.health.lines() == ()


def test_a_blank_cell_in_a_command_log(tmp_path):
    """A row without commands is skipped; a command that lacks one joint is a fault, with its row."""
    rows = ["t,a,b,c", *(f"{10 * k},{k},{k},{k}" for k in range(8))]
    rows[3] = "20,,,"
    (tmp_path / "commands.csv").write_text("\n".join(rows))
    measure = Measure(streams=tmp_path / "log.csv", commands=tmp_path / "commands.csv")
    np.testing.assert_array_equal(
        read_commands(tmp_path / "commands.csv", JOINTS, measure).joints[:, 0], [0, 1, 3, 4, 5, 6, 7]
    )
    rows[5] = "40,4,,4"
    (tmp_path / "commands.csv").write_text("\n".join(rows))
    with pytest.raises(InputError, match="column 'b', row 5: found nan"):
        read_commands(tmp_path / "commands.csv", JOINTS, measure)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.sampled_from(["both", "both", "yaw", "none", "roll", "pitch"]), max_size=60),
    st.lists(st.integers(1, 60), max_size=6),
    st.lists(st.sampled_from([0.0, 0.1, 0.2, np.inf, -np.inf, np.nan, 1.7e308, -1.7e308]), min_size=1, max_size=5),
)
def test_pieces_make_no_difference(kinds, cuts, times):
    """A file's rows in any pieces: the same samples; every row is kept or counted. Times may be any."""
    has = {"roll": ("both", "roll"), "pitch": ("both", "pitch"), "yaw": ("yaw",)}
    value = np.arange(len(kinds), dtype=float)
    channels = {n: np.where(np.isin(kinds, k), value, np.nan) for n, k in has.items()}
    table = pd.DataFrame({"t": np.resize(times, len(kinds)), **channels})
    whole, pieces = ([*sorted({min(c, len(table)) for c in of})] for of in ([], cuts))
    results = []
    for ends in (whole, pieces):
        tally = Tally()
        topics = Topics(tally, separate=False)
        parts = [topics.feed(table.iloc[a:b]) for a, b in zip([0, *ends], [*ends, len(table)], strict=True)]
        topics.rest()
        results.append(pd.concat(parts).reset_index(drop=True))
        assert len(results[-1]) + tally.other == len(table)
    pd.testing.assert_frame_equal(*results)
