"""What is wrong with a log is counted and survived, mostly garbage is refused: counts against what was done."""

import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kincal.identification.streams import tables
from kincal.identification.streams.columns import Rows
from kincal.identification.streams.reading import open_stream, read_log
from kincal.identification.time_stamps import in_seconds
from kincal.urdf.description import Column, Log, Measure
from kincal.urdf.errors import InputError

FAULTS = ("garbage", "checksum", "untimed", "not_finite", "jumped", "repeated", "backwards", "frozen")


def log(n=2000, rate=50.0, seed=0) -> pd.DataFrame:
    random = np.random.default_rng(seed)
    t = np.arange(n) / rate
    noise = 2e-4 * random.normal(size=(2, n))
    return pd.DataFrame({"t": t, "roll": 0.1 * np.sin(t) + noise[0], "pitch": 0.05 * np.cos(t) + noise[1]})


def read(frame: pd.DataFrame, folder, form="csv"):
    file = folder / f"log.{form}"
    frame.to_csv(file, index=False) if form == "csv" else frame.to_parquet(file)
    return read_log(file, measure(file))


def measure(file, **log):
    return Measure(streams=file, table="joints.csv", log=Log(**log))


def adds_up(health) -> bool:
    return health.read == sum(getattr(health, name) for name in ("samples", "other", *FAULTS))


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_clean_log(form, tmp_path):
    frame = log()
    samples, health = read(frame, tmp_path, form)
    pd.testing.assert_frame_equal(samples, frame, check_exact=True)
    assert health.lines() == ()
    assert (health.read, health.samples) == (2000, 2000)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_no_numbers_are_left_out(form, tmp_path):
    frame = log()
    frame.loc[[3, 500, 501], "roll"] = np.nan
    frame.loc[[7, 500], "pitch"] = np.inf
    frame.loc[900, "t"] = np.nan
    samples, health = read(frame, tmp_path, form)
    assert (health.not_finite, health.samples) == (5, 1995)
    np.testing.assert_array_equal(samples["roll"], frame["roll"].drop([3, 7, 500, 501, 900]))
    assert adds_up(health)


def test_iso_times(tmp_path):
    frame = log()
    stamps = pd.to_datetime(1.7e9 + frame["t"], unit="s", utc=True)
    samples, _ = read(frame.assign(t=stamps.map(lambda stamp: stamp.isoformat())), tmp_path)
    np.testing.assert_allclose(samples["t"], 1.7e9 + frame["t"], atol=1e-6)


def test_years_before_nanoseconds_count():
    """64 bits of nanoseconds begin in 1677; 1600 was 370 years, 90 leap days among them, before 1970."""
    written = pd.Series(["1600-01-01T00:00:00Z", "1970-01-01T00:00:01.5Z", "no time"])
    seconds = in_seconds(written)
    np.testing.assert_array_equal(seconds, [-(370 * 365 + 90) * 86400.0, 1.5, np.nan])


def test_a_number_that_signals_is_none():
    bits = np.array([0x7FF0000000000001], dtype=np.uint64)  # as a spoiled byte may leave it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        columns = {"roll": Column.model_validate({"from": "t", "unit": "deg"})}
        found = Rows(Path("log.csv"), columns).values(pd.DataFrame({"t": bits.view(float)}))
    assert np.isnan(found["roll"]).all()


def test_a_gap_and_repeats(tmp_path):
    frame = log()
    frame = pd.concat([frame[:400], frame[399:400], frame[400:1000], frame[1100:]])
    samples, health = read(frame, tmp_path)
    assert (health.repeated, health.gaps, health.samples) == (1, 1, 1900)
    assert health.longest_gap == pytest.approx(101 / 50)
    assert (np.diff(samples["t"]) > 0).all()


def test_samples_out_of_order_are_dropped(tmp_path):
    """Three that come a little late: time has passed them by."""
    frame = log()
    order = np.arange(2000)
    order[[500, 501, 502, 503]] = [503, 500, 501, 502]
    samples, health = read(frame.iloc[order], tmp_path)
    assert (health.backwards, health.samples, health.clock_steps) == (3, 1997, 0)
    assert (np.diff(samples["t"]) > 0).all()


@pytest.mark.parametrize("far", [30.0, 1e9])
def test_a_wrong_stamp_ahead_costs_its_sample_alone(far, tmp_path):
    frame = log()
    frame.loc[[0, 700, 701, 1500], "t"] += far
    samples, health = read(frame, tmp_path)
    assert (health.jumped, health.samples, health.gaps) == (4, 1996, 0)
    np.testing.assert_array_equal(samples["t"], log()["t"].drop([0, 700, 701, 1500]))


def test_a_clock_that_is_set_back_runs_on(tmp_path):
    """An hour back in the midst: no sample is lost, and time runs on as it did."""
    frame = log()
    frame.loc[1000:, "t"] -= 3600.0
    samples, health = read(frame, tmp_path)
    assert (health.clock_steps, health.samples) == (1, 2000)
    assert health.shift == pytest.approx(3600.0)
    np.testing.assert_allclose(samples["t"], log()["t"], atol=1e-9)


def test_stuck_and_saturated_channels(tmp_path):
    """A channel that freezes for 60 samples, and one that is cut at its peaks, as many samples as were spoiled."""
    frame = log()
    frame.loc[1200:1259, "pitch"] = frame.loc[1200, "pitch"]
    frame["roll"] = frame["roll"].clip(upper=0.095)
    cut = int((log()["roll"] >= 0.095).sum())
    samples, health = read(frame, tmp_path)
    assert health.stuck == {"pitch": 60}
    assert 0.8 * cut <= health.saturated["roll"] <= cut
    assert health.frozen == 60 + health.saturated["roll"]
    assert adds_up(health)
    assert len(samples) == health.samples


@pytest.mark.parametrize("step", [2e-4, 2e-3])
@pytest.mark.parametrize("repeat", [1, 10])
def test_coarse_channels_are_not_stuck(step, repeat, tmp_path):
    """A sensor of coarse resolution, and one that is logged ten times as often as it speaks, are in health."""
    frame = log()
    for name in ("roll", "pitch"):
        frame[name] = np.repeat(np.round(frame[name].to_numpy()[::repeat] / step) * step, repeat)
    _, health = read(frame, tmp_path)
    assert (health.stuck, health.saturated, health.samples) == ({}, {}, 2000)


def test_spoiled_lines_of_a_table(tmp_path):
    """Lines cut short, binary rubbish, stray quotes: as many as were spoiled, and the others to the last bit."""
    frame = log(200)
    lines = frame.to_csv(index=False).encode().splitlines()
    lines[10], lines[20], lines[30], lines[40] = lines[10][:9], b"\xff\x00\x9f" * 7, b'"' + lines[30], b"a,b,c"
    file = tmp_path / "log.csv"
    file.write_bytes(b"\n".join(lines))
    samples, health = read_log(file, measure(file))
    assert (health.read, health.garbage, health.not_finite) == (200, 3, 1)
    pd.testing.assert_frame_equal(samples, frame.drop([9, 19, 29, 39]).reset_index(drop=True), check_exact=True)


def test_mostly_garbage_is_refused_with_the_counts(tmp_path, nmea, write):
    lines = [f"{k}.0 {nmea(f'PRDID,{k % 7}.00,2.00,30.00')}" for k in range(100)]
    spoiled = [line[:-2] + "00" if k % 5 < 3 else line for k, line in enumerate(lines)]
    file = write("ship.log", spoiled)
    with pytest.raises(
        InputError, match=r"ship\.log: 40 of 100 records are good .*60 of 100 records fail their checksum"
    ):
        read_log(file, measure(file))
    frame = log(100)
    frame.loc[:70, "roll"] = np.nan
    with pytest.raises(InputError, match=r"29 of 100 records are good samples of a csv stream .*71 of 100"):
        read(frame, tmp_path)


@pytest.mark.parametrize("content", [b"", b"\0" * 5000, b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 40, b"PAR1 no"])
@pytest.mark.parametrize("name", ["log.csv", "log.parquet", "log.bag", "log.mcap", "log.db3", "log"])
def test_no_log_at_all_is_refused(content, name, tmp_path):
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_log(file, measure(file))
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def spoil(content: bytes, damage) -> bytes:
    """Bytes overwritten, pieces taken out, put in or repeated."""
    data = bytearray(content)
    for kind, place, piece in damage:
        k = int(place * len(data))
        if kind == "write":
            data[k : k + len(piece)] = piece
        elif kind == "cut":
            del data[k : k + 40 * len(piece)]
        elif kind == "insert":
            data[k:k] = piece
        else:
            data[k:k] = data[k : k + 40 * len(piece)]
    return bytes(data)


DAMAGE = st.lists(
    st.tuples(
        st.sampled_from(["write", "cut", "insert", "repeat"]),
        st.floats(0, 1),
        st.one_of(st.binary(max_size=12), st.sampled_from([b"\n", b",", b"$", b"*", b'"', b"1e308", b"nan", b"-9e99"])),
    ),
    max_size=12,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(damage=DAMAGE, form=st.sampled_from(["csv", "nmea", "own time"]))
def test_random_damage_is_counted_or_refused(damage, form, tmp_path, nmea):
    """Nothing but InputError is raised, every record is counted once, and what comes out is sound."""
    if form == "csv":
        content = log(120).to_csv(index=False).encode()
    else:
        stamps = [f"2014-08-01T00:00:{k / 2:06.3f}Z " if form == "nmea" else "" for k in range(100)]
        bodies = [f"PASHR,0000{k / 2:05.2f},30.00,T,{k % 9}.00,{k % 7}.00,0.5,0.1,0.1,0.2,1,1" for k in range(100)]
        content = "\r\n".join(s + nmea(b) for s, b in zip(stamps, bodies, strict=True)).encode()
    file = tmp_path / "log.csv"
    file.write_bytes(spoil(content, damage))
    try:
        samples, health = read_log(file, measure(file))
    except InputError:
        return
    assert adds_up(health)
    assert len(samples) == health.samples
    assert np.isfinite(samples.to_numpy()).all()
    assert (np.diff(samples["t"]) > 0).all()


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_memory_does_not_grow_with_the_file(form, tmp_path, monkeypatch):
    """Peak memory of Python's and numpy's allocations, reading a file and one of four times its length."""
    monkeypatch.setattr(tables, "ROWS", 2_500)
    peaks = []
    for n in (10_000, 40_000):
        frame = log(n)
        file = tmp_path / f"{n}.{form}"
        if form == "csv":
            pd.DataFrame(frame.to_numpy().round(6), columns=frame.columns).to_csv(file, index=False)
        else:
            frame.to_parquet(file, row_group_size=10_000)
        tracemalloc.start()
        assert sum(map(len, open_stream(file, measure(file)))) == n
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]
