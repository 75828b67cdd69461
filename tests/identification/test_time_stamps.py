"""Time stamps of loggers against the standard library's calendar."""

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kincal.identification.time_stamps import DAY, Midnights, in_seconds, seconds_of, together

MOMENTS = st.datetimes(datetime(1990, 1, 1), datetime(2090, 1, 1)).map(
    lambda t: t.replace(microsecond=t.microsecond // 1000 * 1000, tzinfo=UTC)
)
FORMATS = {
    "iso": lambda t: t.isoformat(),
    "iso, Z": lambda t: t.isoformat().replace("+00:00", "Z"),
    "blank": lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}",
    "comma": lambda t: f"{t:%Y-%m-%dT%H:%M:%S,%f}",
    "german": lambda t: f"{t.day}.{t.month}.{t.year} {t:%H:%M:%S.%f}",
    "german, comma": lambda t: f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond // 1000:03d}",
    "slashes": lambda t: f"{t:%Y/%m/%d %H:%M:%S.%f}",
    "half days": lambda t: f"{t:%Y/%m/%d} {(t.hour - 1) % 12 + 1}:{t:%M:%S.%f} {'PM' if t.hour > 11 else 'AM'}",
}


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=40, deadline=None)
@given(moments=st.lists(MOMENTS, min_size=1, max_size=5))
def test_texts(name, moments):
    texts = [FORMATS[name](t) for t in moments]
    expected = [t.timestamp() for t in moments]
    np.testing.assert_allclose(in_seconds(pd.Series(texts)), expected, atol=2e-6, rtol=0)
    np.testing.assert_allclose([seconds_of(text) for text in texts], expected, atol=2e-6, rtol=0)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_numbers_count_what_their_size_tells(unit, factor):
    seconds = 1_600_000_000 + 17 * np.arange(50)
    np.testing.assert_allclose(in_seconds(pd.Series(seconds * factor)), seconds, rtol=1e-15)
    np.testing.assert_allclose(in_seconds(pd.Series((seconds * factor).astype(str))), seconds, rtol=1e-15)
    np.testing.assert_array_equal(in_seconds(pd.Series([0.0, -5.5, 3e5])), [0.0, -5.5, 3e5])


def test_no_times():
    """Month first and day first can't be told apart with slashes; nor is there a 30th of February."""
    texts = ["01/02/2026 09:33:20", "30.02.2026 09:00:00", "25:00:00", "13:00 PM", "", "nan", "noon", "1.1.2026"]
    assert np.isnan(in_seconds(pd.Series(texts))).all()
    assert np.isnan([seconds_of(text) for text in texts]).all()


def test_date_and_time_in_two_columns():
    date, time = pd.Series(["31.12.2025", "01.01.2026 "]), pd.Series(["23:59:59.5", " 00:00:00,5"])
    expected = [datetime(2025, 12, 31, 23, 59, 59, 500000, UTC).timestamp() + k for k in range(2)]
    np.testing.assert_allclose(in_seconds(together(date, time)), expected)


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_times_of_day_run_on_over_midnight(size):
    """In chunks of any size, over three midnights, with neighbours out of order."""
    t = 80000.0 + 300.0 * np.arange(1000)
    t[[20, 21]] = t[[21, 20]]
    midnights = Midnights()
    parts = [midnights.run_on(t[k : k + size] % DAY) for k in range(0, 1000, size)]
    np.testing.assert_allclose(np.concatenate(parts), t)
    np.testing.assert_array_equal(Midnights().run_on(np.array([1.7e9, np.nan])), [1.7e9, np.nan])


def test_ticks_since_the_start_are_no_dates():
    """12 minutes in ns are 1994 in ms; but steps of 20 ms would be hours."""
    ticks = pd.Series(1e9 * (720 + 0.02 * np.arange(100)))
    np.testing.assert_array_equal(in_seconds(ticks), ticks)
