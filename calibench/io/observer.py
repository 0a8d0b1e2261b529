"""Observer: where the camera is and how fast it moves at a date, for aberration, parallax, proper motion and refraction.

A date alone puts the camera at the Earth's centre. A `Station` adds the place on the ground (diurnal aberration to 0.32 arcsec,
refraction) or the velocity in orbit (some 5 arcsec), and the shutter.
"""

from __future__ import annotations

import math
import warnings
from datetime import UTC, datetime, timedelta

import erfa
import numpy as np

from ..errors import BadInput
from ..records import Frame, Observer, Refraction, Rolling, Station
from ..records.frame import utc

JD_J2000 = 2451545.0
DAYS_PER_JULIAN_YEAR = 365.25
YEARS = (1972, 2100)  # UTC has leap seconds since 1972; the Earth's ephemeris holds to 2100
LIGHT_KM_S = erfa.CMPS / 1000
ARCMIN_RAD = math.pi / 180 / 60


def observer_at(date_obs: str | None, station: Station | None = None) -> Observer:
    """The observer at an ISO 8601 date (UTC where it names no offset); None: an undated observer at rest at J2000.0.

    Position and velocity of the Earth are barycentric, ICRS axes, from ERFA's epv00 (Bretagnon and Francou VSOP2000,
    simplified; good to 9 km and 2.4 mm/s rms). TT stands for TDB, which differs by less than 2 ms, and UTC for UT1, which
    differs by less than 0.9 s: 14 arcsec of zenith, a thousandth of an arcsecond of aberration. A station's velocity is added;
    a place turns with the Earth (ERFA's pvtob, IAU 2006/2000A).

    Raises:
        BadInput: not a date, outside 1972 to 2100 (a clock that was never set says 1970), or a station without a date.
    """
    if date_obs is None:
        if station is not None and (station.latitude_rad is not None or station.velocity_km_s is not None):
            raise BadInput("a frame with a place or a velocity has no date", mend="give date_obs (DATE-OBS), in UTC")
        return Observer()
    instant = _instant(date_obs)
    with warnings.catch_warnings():
        # ERFA calls a date dubious when leap seconds after its release may be missing: a second is 30 km of position.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        utc_days = erfa.dtf2d("UTC", instant.year, instant.month, instant.day, instant.hour, instant.minute,
                              instant.second + instant.microsecond * 1e-6)
        tt_days = erfa.taitt(*erfa.utctai(*utc_days))
        _, barycentric = erfa.epv00(*tt_days)
        velocity = barycentric["v"] * (erfa.AULT / erfa.DAYSEC)
        refraction = None
        if station is not None and station.velocity_km_s is not None:
            velocity = velocity + np.array(station.velocity_km_s) / LIGHT_KM_S
        if station is not None and station.latitude_rad is not None:
            turning, refraction = _on_the_ground(station, utc_days, tt_days)
            velocity = velocity + turning
    epoch_jyear = 2000.0 + ((tt_days[0] - JD_J2000) + tt_days[1]) / DAYS_PER_JULIAN_YEAR
    return Observer(epoch_jyear=float(epoch_jyear), position_au=barycentric["p"], velocity_c=velocity, dated=True,
                    time_utc=instant.replace(tzinfo=None).isoformat(), refraction=refraction)


def frame_observer(frame: Frame, station: Station | None = None) -> Observer:
    """The observer of one frame: at its mid-exposure (date_obs is its start, as in FITS), of a rolling shutter that of the
    image's middle row. station: goes before the frame's own.

    Raises:
        BadInput: as `observer_at`.
    """
    station = station or frame.station
    rows = frame.image_size_px[1]
    row_time_s = station.row_time_s if station and station.row_time_s else 0.0
    late_s = (frame.exposure_s or 0.0) / 2 + row_time_s * (rows - 1) / 2
    date = None if frame.date_obs is None else (_instant(frame.date_obs) + timedelta(seconds=late_s)).isoformat()
    observer = observer_at(date, station)
    if not row_time_s:
        return observer
    rolling = Rolling(row_time_s=row_time_s if station.readout == "down" else -row_time_s, middle_row=(rows - 1) / 2,
                      rate_rad_s=np.array(station.rate_rad_s or (0.0, 0.0, 0.0)))
    return Observer(**(vars(observer) | {"rolling": rolling}))


def _instant(date_obs: str) -> datetime:
    try:
        instant = utc(date_obs).astimezone(UTC)
    except ValueError as error:
        raise BadInput(f"date of observation '{date_obs}' is no ISO 8601 date",
                       mend="write it as 2024-05-17T21:04:05, in UTC") from error
    if not YEARS[0] <= instant.year < YEARS[1]:
        raise BadInput(f"date of observation {date_obs} is outside {YEARS[0]} to {YEARS[1]}",
                       mend="correct the date, or remove it: the frame is then solved without aberration")
    return instant


def _on_the_ground(station: Station, utc_days: tuple, tt_days: tuple) -> tuple[np.ndarray, Refraction | None]:
    """Velocity (3,) of a place about the Earth's centre, in units of c, and its refraction; GCRS axes."""
    to_gcrs = erfa.c2i06a(*tt_days).T
    turn = erfa.era00(*utc_days)
    moving = erfa.pvtob(station.longitude_rad, station.latitude_rad, station.height_m, 0.0, 0.0, 0.0, turn)
    velocity_c = to_gcrs @ moving["v"] / erfa.CMPS
    if station.refraction is None:
        return velocity_c, None
    local, latitude = turn + station.longitude_rad, station.latitude_rad
    zenith = to_gcrs @ [math.cos(latitude) * math.cos(local), math.cos(latitude) * math.sin(local), math.sin(latitude)]
    if station.refraction == "erfa":
        constants = erfa.refco(station.pressure_hpa, station.air_temperature_c, station.humidity, station.wavelength_um)
    else:  # Bennett 1982 is for 1010 hPa and 10 degrees Celsius
        constants = (ARCMIN_RAD * station.pressure_hpa / 1010 * 283 / (273 + station.air_temperature_c), 0.0)
    return velocity_c, Refraction(zenith_icrs=zenith, model=station.refraction, constants_rad=tuple(map(float, constants)))
