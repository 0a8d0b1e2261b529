"""The Earth's place and speed, against astropy's time scales and against the Earth's own motion."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import get_body_barycentric_posvel, solar_system_ephemeris
from astropy.time import Time

from calibench.errors import BadInput
from calibench.io.observer import observer_at

C_KM_S = 299792.458


@pytest.mark.parametrize("date", ["1991-04-02T13:30:00", "2019-07-29T20:47:26.5", "2025-12-31T23:59:59"])
def test_against_astropy(date):
    observer = observer_at(date)
    time = Time(date, scale="utc")
    with solar_system_ephemeris.set("builtin"):
        position, velocity = get_body_barycentric_posvel("earth", time)
    np.testing.assert_allclose(observer.position_au, position.xyz.to_value(u.au), atol=1e-9)
    np.testing.assert_allclose(observer.velocity_c * C_KM_S, velocity.xyz.to_value(u.km / u.s), atol=1e-6)
    assert observer.epoch_jyear == pytest.approx(time.tdb.jyear, abs=1e-9)
    assert observer.dated


def test_velocity_is_the_change_of_position():
    before, after = observer_at("2024-03-20T11:00:00"), observer_at("2024-03-20T13:00:00")
    moved_km = (after.position_au - before.position_au) * 149597870.7
    np.testing.assert_allclose(observer_at("2024-03-20T12:00:00").velocity_c * C_KM_S, moved_km / 7200, atol=1e-3)


def test_offsets_are_honoured():
    utc, vienna = observer_at("2024-05-17T19:00:00Z"), observer_at("2024-05-17T21:00:00+02:00")
    np.testing.assert_array_equal(utc.velocity_c, vienna.velocity_c)


def test_without_a_date_nothing_moves():
    observer = observer_at(None)
    assert not observer.dated and observer.epoch_jyear == 2000.0 and not observer.velocity_c.any()


@pytest.mark.parametrize("date", ["1970-01-01T00:00:00", "2150-01-01", "last night", ""])
def test_impossible_dates_are_refused(date):
    with pytest.raises(BadInput):
        observer_at(date)
