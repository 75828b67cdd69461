"""NMEA 4 TAG blocks, their checksums by hand."""

from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kincal.identification.streams.nmea_lines import parsed_line
from kincal.identification.streams.reading import read_log
from kincal.urdf.description import Log, Measure

START = 1406851200


def tag(fields: str) -> str:
    return f"\\{fields}*{reduce(lambda a, b: a ^ b, fields.encode()):02X}\\"


def logged(file, **log):
    return read_log(file, Measure(streams=file, table="joints.csv", log=Log(**log)))


@pytest.mark.parametrize(("scale", "step"), [(1, 1.0), (1000, 0.25)])
@pytest.mark.parametrize("kind", ["PRDID,3.00,{:.2f},30.00", "PSXN,23,{:.2f},3.00,30.00,0.50"])
def test_the_time_of_a_block(scale, step, kind, nmea, write):
    """Seconds and milliseconds since 1970; the source and the line count beside it."""
    lines = [
        tag(f"s:mru{k % 2},n:{k},c:{round(scale * (START + step * k))}") + nmea(kind.format(0.01 * k))
        for k in range(40)
    ]
    samples, health = logged(write("ship.log", lines))
    assert health.lines() == ()
    np.testing.assert_allclose(samples["t"], START + step * np.arange(40), atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(samples["roll"]), 0.01 * np.arange(40), atol=1e-9)


def test_a_block_with_a_wrong_checksum_is_counted_and_skipped(nmea, write):
    lines = [tag(f"c:{1000 * START + 100 * k}") + nmea(f"PRDID,3.00,{k}.00,30.00") for k in range(30)]
    lines[7] = lines[7].replace("c:", "c:9")
    lines[8] = lines[8].replace("*", "*\\", 1)
    lines[9] = lines[9].replace("PRDID,3", "PRDID,4")
    samples, health = logged(write("ship.log", lines))
    assert (health.checksum, health.read, len(samples)) == (3, 30, 27)
    np.testing.assert_allclose(samples["t"], START + 0.1 * np.delete(np.arange(30), [7, 8, 9]), atol=1e-6)


def test_one_time_for_a_group_and_on_a_line_before(nmea, write):
    """The heading's block gives its attitude the time; a block alone gives it to the sentence after it."""
    lines = []
    for k in range(20):
        lines += [tag(f"g:1-2-{k},c:{START + k}") + nmea("HEHDT,30.00,T"), tag(f"g:2-2-{k}") + nmea("PRDID,3.0,2.0,")]
        lines += [tag(f"c:{1000 * (START + k) + 500}"), nmea("PRDID,3.0,2.0,30.0"), nmea("GPGLL,,,,,,V,N")]
    samples, health = logged(write("ship.log", lines))
    np.testing.assert_allclose(samples["t"], START + 0.5 * np.arange(40), atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(samples["yaw"]), -30.0)
    assert (health.other, health.bad) == (60, 0)


def test_whole_seconds_of_a_faster_sensor_are_spread(nmea, write):
    lines = [tag(f"c:{START + k // 10}") + nmea(f"PRDID,3.00,{k % 60}.00,30.00") for k in range(300)]
    samples, health = logged(write("ship.log", lines))
    assert health.bad == 0
    np.testing.assert_allclose(samples["t"], START + 0.1 * np.arange(300), atol=1e-6)


def test_other_talkers_are_no_garbage(nmea, write):
    lines = [tag(f"c:{START + k}") + nmea("PRDID,3.0,2.0,30.0") for k in range(20)]
    lines += [tag(f"c:{START + 20}") + nmea("AIVDM,1,1,,A,13u?etPv2;0n:dDPwUM1U1Cb069D,0").replace("$", "!")]
    _, health = logged(write("ship.log", lines))
    assert (health.other, health.garbage, health.checksum) == (1, 0, 0)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.sampled_from(["\\", "c:1700000000", "*5E", "$GPHDT,1.0,T*00", "g:1-2-3", ",", "!", "é", "\0"])))
def test_any_line_is_parsed_or_none(parts):
    sentence = parsed_line("".join(parts).encode())
    assert sentence is None or isinstance(sentence.stamp, float)
