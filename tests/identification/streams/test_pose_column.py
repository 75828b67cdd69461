"""Streams with a pose column survive what logs survive: exact counts, and what is left is as in a clean file."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kincal.identification.inclinometer import filter_stream
from kincal.identification.streams.health import StreamHealth
from kincal.identification.streams.reading import read_stream
from kincal.urdf.description import Column, Filter, Measure, Sensor
from kincal.urdf.errors import InputError

FAULTS = (
    "garbage checksum untimed not_finite unposed jumped repeated backwards frozen incomplete".split()  # noqa: SIM905
)
POSES, SAMPLES = 20, 100


def still(poses: int = POSES, samples: int = SAMPLES, seed: int = 0, resolution: float = 0.0) -> pd.DataFrame:
    """A stream of poses held still for 2 s each, without any fault."""
    random = np.random.default_rng(seed)
    angles = random.uniform(-0.3, 0.3, (poses, 3)).repeat(samples, axis=0) + 2e-4 * random.normal(
        size=(poses * samples, 3)
    )
    if resolution:
        angles = np.round(angles / resolution) * resolution
    t, pose = np.arange(poses * samples) / 50, np.repeat(np.arange(float(poses)), samples)
    return pd.DataFrame({"t": t, "pose": pose, "roll": angles[:, 0], "pitch": angles[:, 1], "yaw": angles[:, 2]})


def read(frame: pd.DataFrame, folder, form: str = "csv", **measure) -> tuple[pd.DataFrame, StreamHealth]:
    file = folder / f"stream.{form}"
    frame.to_csv(file, index=False) if form == "csv" else frame.to_parquet(file)
    return read_stream(file, Measure(**measure))


def survived(found: tuple[pd.DataFrame, StreamHealth], expected: pd.DataFrame, **counts: int) -> StreamHealth:
    """The samples expected, to the last bit, and these faults alone."""
    samples, health = found
    pd.testing.assert_frame_equal(samples, expected.reset_index(drop=True), check_exact=True)
    assert {name: n for name in FAULTS if (n := getattr(health, name))} == counts
    assert health.samples == len(samples) == health.read - sum(counts.values()) - health.other
    return health


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_no_numbers_are_left_out(form, bad, tmp_path):
    frame = still()
    for row, name in enumerate(frame):
        frame.loc[50 + 300 * row, name] = bad
    clean = frame.drop([50, 350, 650, 950, 1250])
    survived(read(frame, tmp_path, form), clean, not_finite=3, unposed=1, incomplete=1)


@pytest.mark.parametrize("pose", ["4.5", "", "first", "nan"])
def test_a_pose_that_is_no_whole_number(pose, tmp_path):
    frame = still()
    spoiled = frame.assign(pose=frame["pose"].astype(object))
    spoiled.loc[7, "pose"] = pose
    survived(read(spoiled, tmp_path), frame.drop(7), unposed=1)


def test_spoiled_lines(tmp_path):
    frame = still()
    lines = frame.to_csv(index=False).encode().splitlines()
    lines[10], lines[20], lines[30], lines[40] = lines[10][:9], b"\xff\x00\x9f" * 7, b'"' + lines[30], b"a,b,c,d,e"
    (tmp_path / "stream.csv").write_bytes(b"\n".join(lines))
    found = read_stream(tmp_path / "stream.csv", Measure())
    survived(found, frame.drop([9, 19, 29, 39]), garbage=3, not_finite=1)


def test_one_cell_of_text_among_decimal_commas(tmp_path):
    frame = still()
    spoiled = frame.astype(str).map(lambda cell: cell.replace(".", ","))
    spoiled.loc[7, "roll"] = "------"
    spoiled.to_csv(tmp_path / "stream.csv", sep=";", index=False)
    found = read_stream(tmp_path / "stream.csv", Measure(separator=";", decimal=","))
    survived(found, frame.drop(7), not_finite=1)


def test_records_that_come_twice(tmp_path):
    frame = still()
    survived(read(frame.iloc[np.repeat(np.arange(len(frame)), 1 + (np.arange(len(frame)) == 300))], tmp_path),
             frame, repeated=1)  # fmt: skip


def test_a_clock_coarser_than_the_sampling(tmp_path):
    """Whole seconds at 50 samples a second: times come again, records don't."""
    frame = still()
    frame["t"] = np.floor(frame["t"])
    assert survived(read(frame, tmp_path), frame).lines() == ()


def test_samples_out_of_order(tmp_path):
    """Three that come late within their pose; poses in any order are none of its business."""
    frame = still()
    order = np.arange(len(frame))
    order[[550, 551, 552, 553]] = [553, 550, 551, 552]
    survived(read(frame.iloc[order], tmp_path), frame.drop([550, 551, 552]), backwards=3)
    shuffled = frame.iloc[np.random.default_rng(0).permutation(POSES).repeat(SAMPLES) * SAMPLES
                          + np.tile(np.arange(SAMPLES), POSES)]  # fmt: skip
    health = survived(read(shuffled, tmp_path), shuffled)
    steps = np.diff(shuffled["t"])
    assert (health.clock_steps, health.shift) == (np.sum(steps < 0), 0.0)


@pytest.mark.parametrize("place", [0, 1, 50, 98, 99], ids=str)
@pytest.mark.parametrize("far", [30.0, 1e9])
def test_a_wrong_stamp_ahead_costs_its_sample_alone(far, place, tmp_path):
    """First, last and within a pose."""
    frame = still()
    clean = frame.drop(300 + place)
    frame.loc[300 + place, "t"] += far
    survived(read(frame, tmp_path), clean, jumped=1)


def test_a_clock_that_is_set_back(tmp_path):
    """An hour back within a pose: its times run on, and no sample of it or of the next ones is lost."""
    frame = still()
    clean = frame.copy()
    frame.loc[730:, "t"] -= 3600.0
    samples, health = read(frame, tmp_path)
    assert (health.clock_steps, health.samples) == (1, len(frame))
    assert health.shift == pytest.approx(3600.0)
    np.testing.assert_allclose(samples["t"][:800], clean["t"][:800], atol=1e-9)
    pd.testing.assert_frame_equal(samples[800:], frame[800:], check_exact=True)


def test_each_pose_with_a_clock_of_its_own(tmp_path):
    frame = still()
    frame["t"] -= 2.0 * frame["pose"]
    assert survived(read(frame, tmp_path), frame).clock_steps == POSES - 1


def test_gaps_are_counted(tmp_path):
    frame = still().drop(range(430, 460))
    health = survived(read(frame, tmp_path), frame)
    assert (health.gaps, round(health.longest_gap, 6)) == (1, 0.62)


@pytest.mark.parametrize("channel, fault", [("pitch", "frozen"), ("yaw", "incomplete")])
def test_a_channel_that_is_stuck_for_a_while(channel, fault, tmp_path):
    frame = still()
    frame.loc[540:599, channel] = frame.loc[540, channel]
    health = survived(read(frame, tmp_path), frame.drop(range(540, 600)), **{fault: 60})
    assert health.stuck == {channel: 60}


def test_a_saturated_channel(tmp_path):
    """For thirty samples at the end of its range."""
    frame = still()
    frame.loc[540:569, "roll"] = 0.5
    health = survived(read(frame, tmp_path), frame.drop(range(540, 570)), frozen=30)
    assert health.saturated == {"roll": 30}


def test_a_pose_that_is_stuck_is_left_to_the_filter(tmp_path):
    """It is counted, and the filter says why the pose is left out."""
    frame = still()
    frame.loc[frame["pose"] == 4, "pitch"] = 0.125
    samples, health = read(frame, tmp_path)
    assert health.stuck == {"pitch": SAMPLES}
    found = filter_stream(samples, np.arange(POSES), Sensor(tilt_deg=0.01), Filter(), "stream.csv")
    assert [str(d) for d in found.dropped] == [
        "pose 4 was left out: channel 'pitch' is stuck at 7.16197 degrees for all 100 samples"
    ]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("resolution", [1e-4, 2e-4, 4e-4, 8e-4])
def test_coarse_channels_are_not_stuck(resolution, seed, tmp_path):
    """Steps of half to four sigmas of noise: poses in the midst of a step repeat a value long, and lose nothing."""
    frame = still(40, 250, seed, resolution)
    assert survived(read(frame, tmp_path, "parquet"), frame).lines() == ()


def test_a_channel_that_most_samples_lack_is_left_out(tmp_path):
    frame = still()
    frame.loc[300:, "yaw"] = np.nan
    health = survived(read(frame, tmp_path), frame.drop(columns="yaw"))
    assert health.lines() == ("channel 'yaw' is left out: too many samples lack it",)


def test_mostly_garbage_is_refused_with_the_counts(tmp_path):
    frame = still()
    frame.loc[: 1.1 * len(frame) // 2, "roll"] = np.nan
    with pytest.raises(InputError, match=r"stream\.csv: 899 of 2000 records are good samples .*1101 of 2000 records"):
        read(frame, tmp_path)
    frame = still().assign(pose="first")
    with pytest.raises(InputError, match=r"0 of 2000 records are good .*2000 of 2000 records have no whole number for"):
        read(frame, tmp_path)


def test_a_mapped_pose_column_that_is_missing(tmp_path):
    with pytest.raises(InputError, match=r"stream\.csv: column 'Lage' is missing"):
        read(still().drop(columns="pose"), tmp_path, columns={"pose": Column.model_validate({"from": "Lage"})})


@pytest.fixture(scope="module")
def clean_lines() -> list[bytes]:
    return still(5, 24).to_csv(index=False).encode().splitlines(keepends=True)


CELLS = st.sampled_from([b"", b"nan", b"-inf", b"1e308", b"-9e99", b"0", b"1", b"3600", b"a", b'"', b"\0", b"\n", b","])
DAMAGE = st.lists(
    st.one_of(
        st.tuples(st.just("cell"), st.integers(1, 120), st.integers(0, 4), CELLS),
        st.tuples(st.sampled_from(["cut", "repeat", "later", "stuck"]), st.integers(1, 120), st.integers(1, 60), CELLS),
        st.tuples(st.just("bytes"), st.integers(0, 120), st.integers(0, 40), st.binary(max_size=12)),
    ),
    max_size=8,
)


def spoil(lines: list[bytes], damage) -> bytes:
    """Cells and bytes overwritten, lines taken out, repeated, moved to the end, or set to the first one's angles."""
    lines = list(lines)
    for kind, row, number, piece in damage:
        row = min(row, len(lines) - 1)
        if kind == "cell":
            cells = lines[row].rstrip(b"\n").split(b",")
            cells[min(number, len(cells) - 1)] = piece
            lines[row] = b",".join(cells) + b"\n"
        elif kind == "bytes":
            lines[row] = lines[row][:number] + piece + lines[row][number + len(piece) :]
        else:
            block = lines[row : row + number]
            if kind in ("cut", "later"):
                del lines[row : row + number]
            if kind == "stuck":
                angles = block[0].split(b",")[2:]
                lines[row : row + number] = [b",".join(line.split(b",")[:2] + angles) for line in block]
            elif kind != "cut":
                lines += block
    return b"".join(lines)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100, deadline=None)
@given(damage=DAMAGE)
def test_random_damage_is_survived_or_refused(damage, tmp_path, clean_lines):
    """Nothing but InputError; every record is counted once, what comes out is sound, and each pose has an answer."""
    file = tmp_path / "stream.csv"
    file.write_bytes(spoil(clean_lines, damage))
    try:
        samples, health = read_stream(file, Measure())
        found = filter_stream(samples, np.arange(5), Sensor(), Filter(), str(file))
    except InputError:
        return
    assert health.read == sum(getattr(health, name) for name in ("samples", "other", *FAULTS))
    assert len(samples) == health.samples
    assert np.isfinite(samples.to_numpy()).all()
    assert (samples.groupby("pose")["t"].diff().dropna() >= 0).all()
    assert np.isfinite(found.rows.to_numpy()).all()
    assert sorted([*found.rows["pose"], *(d.pose for d in found.dropped)]) == list(range(5))
    assert 2 * len(found.dropped) < 5
