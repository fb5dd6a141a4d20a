from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.formats.rfc3339 import format_time, format_time_exact, parse_time_us

LAST_US = 253_402_300_799_999_999  # 9999-12-31T23:59:59.999999Z


@pytest.mark.parametrize(
    ("text", "time_us"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("2025-05-12T06:00:00.050Z", 1_747_029_600_050_000),
        ("2025-05-12t06:00:00.05z", 1_747_029_600_050_000),
        ("2025-05-12 06:00:00.000001Z", 1_747_029_600_000_001),
        ("2025-05-12T08:00:00.050+02:00", 1_747_029_600_050_000),
        ("2025-05-11T20:30:00.050-09:30", 1_747_029_600_050_000),
        ("2025-05-12T06:00:00-00:00", 1_747_029_600_000_000),
        ("2016-12-31T23:59:60Z", 1_483_228_800_000_000),
        ("2017-01-01T00:59:60+01:00", 1_483_228_800_000_000),
    ],
)
def test_known_instants(text, time_us):
    assert parse_time_us(text) == time_us


@pytest.mark.parametrize(
    "text",
    [
        "",
        "now",
        "2025-05-12",
        "2025-05-12T06:00:00",
        "2025-05-12T06:00Z",
        "20250512T060000Z",
        "2025-02-30T06:00:00Z",
        "2025-05-12T24:00:00Z",
        "2025-05-12T06:00:00.Z",
        "2025-05-12T06:00:00.0000001Z",
        "2025-05-12T06:00:00+24:00",
        "2025-05-12T06:00:60Z",
        "1969-12-31T23:59:59Z",
        "2025-05-12T06:00:00Z\n",
        "٢٠٢٥-05-12T06:00:00Z",
    ],
)
def test_what_is_no_timestamp_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        parse_time_us(text)


@given(st.integers(0, LAST_US))
def test_exact_text_reads_back_to_the_same_microsecond(time_us):
    assert parse_time_us(format_time_exact(time_us)) == time_us


@given(st.integers(0, LAST_US))
def test_milliseconds_are_cut_off_not_rounded(time_us):
    text = format_time(time_us)

    assert len(text) == len("2025-05-12T06:00:00.050Z")
    assert parse_time_us(text) == time_us // 1000 * 1000


@given(st.integers(86_400_000_000, LAST_US - 86_400_000_000), st.integers(-23 * 60, 23 * 60))
def test_any_offset_names_the_same_instant(time_us, offset_min):
    zone = timezone(timedelta(minutes=offset_min))
    local = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_us)

    assert parse_time_us(local.astimezone(zone).isoformat()) == time_us
