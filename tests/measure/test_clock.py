"""Exposures that do not fit into the time in which the frames were taken."""

from __future__ import annotations

import pytest

from calibench.errors import BadInput
from calibench.measure._frames.clock import check_clock


def starts(interval_s, exposure_s, count=10):
    return [(f"2024-05-17T21:{int(i * interval_s // 60):02d}:{i * interval_s % 60:06.3f}", exposure_s) for i in range(count)]


def test_milliseconds_read_as_seconds_are_refused_in_any_order():
    taken = starts(0.2, 100.0)
    with pytest.raises(BadInput, match="state exposures of 900 s together, but were taken within 1.8 s"):
        check_clock(taken[::-1])
    assert check_clock(starts(0.2, 0.1)) == ()


def test_half_the_time_is_said_and_readout_while_exposing_is_not():
    assert "in seconds?" in check_clock(starts(0.5, 1.0))[0]
    assert check_clock(starts(1.0, 1.0)) == ()


def test_one_stamp_for_all_tells_nothing_and_time_zones_are_minded():
    assert check_clock(starts(0.0, 10.0)) == ()
    zoned = ("2024-05-17T21:00:00Z", "2024-05-17T23:00:20+02:00", "2024-05-17T21:00:10")
    assert check_clock([(date, 10.0) for date in zoned]) == ()
