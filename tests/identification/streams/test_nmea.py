"""NMEA 0183 logs: sentences, signs, time, by sentences that are formatted here."""

from datetime import UTC, datetime

import numpy as np
import pytest

from kincal.identification.streams.reading import read_log
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import from_zyx_angles

STAMP = "2014-08-01T00:00:{:06.3f}Z"
BODIES = {  # 2 degrees port up, 3 bow up, heading 30 (east of north)
    "PSXN": "PSXN,23,2.00,3.00,30.00,0.50",
    "PASHR": "PASHR,0000{:05.2f},30.00,T,2.00,3.00,0.50,0.1,0.1,0.2,1,1",
    "PRDID": "PRDID,3.00,2.00,30.00",
    "XDR": "IIXDR,A,3.00,D,PTCH,A,2.00,D,ROLL",
}


def logged(file, **log):
    return read_log(file, Measure(streams=file, table="joints.csv", log=Log(**log)))


@pytest.mark.parametrize("kind", BODIES)
def test_signs_of_a_known_attitude(kind, nmea, write):
    """Port up, bow up, bow to the north-east: where the ship's axes then point, not which sign an angle has."""
    lines = []
    for k in range(20):
        if kind == "XDR":
            lines.append(f"{STAMP.format(k)} {nmea('HEHDT,30.00,T')}")
        lines.append(f"{STAMP.format(k + 0.1)} {nmea(BODIES[kind].format(k))}")
    samples, health = logged(write("ship.log", lines))
    assert health.lines() == ()
    assert len(samples) == 20
    ship = from_zyx_angles(samples[["yaw", "pitch", "roll"]].to_numpy())[0]  # its columns: forward, port, up
    forward, port = ship[:, 0], ship[:, 1]
    assert np.rad2deg(np.arcsin(forward[2])) == pytest.approx(3.0)  # the bow is up
    assert port[2] == pytest.approx(np.sin(np.deg2rad(2.0)) * np.cos(np.deg2rad(3.0)))  # port is up
    assert np.rad2deg(np.arctan2(forward[1], forward[0])) == pytest.approx(-30.0)  # y is west of north
    if kind == "PSXN":
        assert samples["heave"].to_numpy() == pytest.approx(-0.5)  # Seapath's is positive down


@pytest.mark.parametrize(
    "stamp",
    ["2014-08-01T00:00:{:06.3f}Z ", "2014-08-01 00:00:{:06.3f}\t", "2014-08-01T02:00:{:06.3f}+02:00,", "E", "M"],
)
def test_logger_stamps(stamp, nmea, write):
    """ISO 8601 with and without a zone, seconds and milliseconds since 1970: all the same time."""
    prefix = {"E": lambda t: f"{1406851200 + t:.3f}\t", "M": lambda t: f"{1406851200000 + round(1000 * t)} "}
    before = prefix.get(stamp, stamp.format)
    samples, _ = logged(write("ship.log", [before(0.5 * k) + nmea(BODIES["PSXN"]) for k in range(30)]))
    np.testing.assert_allclose(samples["t"], 1406851200 + 0.5 * np.arange(30), atol=1e-6)


def test_time_of_the_sentences_own(nmea, write):
    """PASHR over midnight, without a date and then with one."""
    bodies = [
        f"PASHR,{h:02d}{m:02d}{s:05.2f},30.00,T,2.00,{k % 7}.00,0.5,0.1,0.1,0.2,1,1"
        for k, (h, m, s) in enumerate(
            [(23, 59, 50 + 0.5 * k) for k in range(20)] + [(0, 0, 0.5 * k) for k in range(20)]
        )
    ]
    samples, _ = logged(write("ship.log", [nmea(body) for body in bodies]))
    np.testing.assert_allclose(samples["t"], 86390 + 0.5 * np.arange(40), atol=1e-6)
    dated = [nmea("GPZDA,235949.90,31,12,2020,00,00"), *(nmea(body) for body in bodies)]
    samples, health = logged(write("ship.log", dated))
    start = datetime(2020, 12, 31, 23, 59, 50, tzinfo=UTC).timestamp()
    np.testing.assert_allclose(samples["t"], start + 0.5 * np.arange(40), atol=1e-6)
    assert (health.read, health.samples, health.other) == (41, 40, 1)


def test_sentences_between_two_zda_are_spread(nmea, write):
    """Ten samples a second, and the time once a second."""
    lines = []
    for k in range(6):
        lines.append(nmea(f"GPZDA,0000{k:05.2f},01,08,2014,,"))
        lines += [nmea(f"PSXN,23,2.0{j},3.00,30.00,0.50") for j in range(10)]
    samples, _ = logged(write("ship.log", lines))
    np.testing.assert_allclose(samples["t"] - 1406851200, 0.1 * np.arange(60), atol=1e-6)


def test_a_nominal_rate_keeps_the_place_of_a_lost_sentence(nmea, write):
    lines = [nmea(f"PRDID,{k % 9}.00,2.00,30.00") for k in range(40)]
    lines[7] = lines[7][:-2] + "00"
    samples, health = logged(write("ship.log", lines), rate_hz=20.0)
    np.testing.assert_allclose(samples["t"], np.delete(np.arange(40), 7) / 20, atol=1e-9)
    assert (health.checksum, health.samples) == (1, 39)


def test_no_time_at_all_is_refused(nmea, write):
    with pytest.raises(InputError, match=r"ship\.log: no time: no stamps or TAG blocks.*rate_hz"):
        logged(write("ship.log", [nmea(BODIES["PRDID"])] * 30))


def test_one_kind_of_sentence_is_taken(nmea, write):
    """Two instruments on one line: the first that speaks, or the one that is asked for."""
    lines = [
        f"{STAMP.format(k)} {nmea(body)}"
        for k in range(30)
        for body in (f"PSXN,23,{k % 9}.00,3.00,30.00,0.50", f"PRDID,3.00,-{k % 9}.00,30.00")
    ]
    first, _ = logged(write("ship.log", lines))
    other, health = logged(write("ship.log", lines), topic="prdid")
    np.testing.assert_allclose(first["roll"], -other["roll"])
    assert health.other == 30
    with pytest.raises(InputError, match=r"measure\.log\.topic: found 'GGA'; of NMEA allowed are PSXN, PASHR"):
        logged(write("ship.log", lines), topic="GGA")


def test_ship_logs_agree_as_their_readme_says(shared_data):
    """Two Seapaths on one ship: rms of each, and bias and standard deviation of their difference after alignment."""
    from kincal.identification.streams.alignment import align

    folder = shared_data / "nbp1406_ship_motion"
    if not folder.is_dir():
        pytest.skip("the ship's logs are not there")
    (first, health), (second, other) = (logged(folder / f"NBP1406_{name}-2014-08-01") for name in ("s330", "seap"))
    assert (health.samples, other.samples) == (625, 714)
    assert (health.bad, other.bad) == (0, 0)
    rms = {c: np.rad2deg(first[c].std()) for c in ("roll", "pitch")} | {"heave": first["heave"].std()}
    assert rms == pytest.approx({"roll": 0.58, "pitch": 1.86, "heave": 1.12}, rel=0.02)
    found = align(first, second)
    # the README's figures are in NMEA's signs: of pitch and heading the other way round
    bias = {"roll": -0.228, "pitch": 0.035, "yaw": 0.82}
    std = {"roll": 0.022, "pitch": 0.051, "yaw": 0.037}
    assert {c: np.rad2deg(v) for c, v in found.bias.items()} == pytest.approx(bias, rel=0.2)
    assert {c: np.rad2deg(v) for c, v in found.std.items()} == pytest.approx(std, rel=0.2)
    assert abs(found.lag) < 0.5
