"""Observer: where the Earth is and how fast it moves at a date, for aberration, parallax and proper motion."""

from __future__ import annotations

import warnings

import erfa

from ..errors import BadInput
from ..records import Observer
from .metadata import utc

JD_J2000 = 2451545.0
DAYS_PER_JULIAN_YEAR = 365.25
YEARS = (1972, 2100)  # UTC has leap seconds since 1972; the Earth's ephemeris holds to 2100


def observer_at(date_obs: str | None) -> Observer:
    """The Earth's centre at an ISO 8601 date (UTC where it names no offset); None: an undated observer at rest at J2000.0.

    Position and velocity are barycentric, ICRS axes, from ERFA's epv00 (Bretagnon and Francou VSOP2000, simplified; good to
    9 km and 2.4 mm/s rms). TT stands for TDB, which differs by less than 2 ms. The turning of the Earth adds at most
    0.47 km/s, 0.32 arcsec of aberration, and is left out.

    Raises:
        BadInput: not a date, or outside 1972 to 2100 (a camera's clock that was never set says 1970).
    """
    if date_obs is None:
        return Observer()
    try:
        instant = utc(date_obs)
    except ValueError as error:
        raise BadInput(f"date of observation '{date_obs}' is no ISO 8601 date",
                       mend="write it as 2024-05-17T21:04:05, in UTC") from error
    if not YEARS[0] <= instant.year < YEARS[1]:
        raise BadInput(f"date of observation {date_obs} is outside {YEARS[0]} to {YEARS[1]}",
                       mend="correct the date, or remove it: the frame is then solved without aberration")
    with warnings.catch_warnings():
        # ERFA calls a date dubious when leap seconds after its release may be missing: a second is 30 km of position.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        utc_days = erfa.dtf2d("UTC", instant.year, instant.month, instant.day, instant.hour, instant.minute,
                              instant.second + instant.microsecond * 1e-6)
        tt_days = erfa.taitt(*erfa.utctai(*utc_days))
        _, barycentric = erfa.epv00(*tt_days)
    epoch_jyear = 2000.0 + ((tt_days[0] - JD_J2000) + tt_days[1]) / DAYS_PER_JULIAN_YEAR
    return Observer(epoch_jyear=float(epoch_jyear), position_au=barycentric["p"],
                    velocity_c=barycentric["v"] * (erfa.AULT / erfa.DAYSEC), dated=True)
