"""Where a camera sees the stars, against ERFA's chains (apco13: ground, apcs13: orbit), and what each effect costs.

Light deflection by the Sun is in ERFA's chain and not in ours; the star places handed to ours are deflected first (eraLdsun).
"""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import projection, sphere
from calibench.io.observer import frame_observer, observer_at
from calibench.io.star_table import load_star_table
from calibench.records import Frame, Identification, Intrinsics, Observer, Station
from calibench.stars.astrometry import as_observed
from calibench.stars.frame_attitude import find_attitude
from calibench.stars.sky_catalogue import SkyCatalogue, star_directions

ARCSEC = 180 * 3600 / np.pi
DATE = "2024-05-17T21:04:05"
UTC = erfa.dtf2d("UTC", 2024, 5, 17, 21, 4, 5.0)
TT = erfa.taitt(*erfa.utctai(*UTC))
PLACE = dict(latitude_rad=np.radians(48.2), longitude_rad=np.radians(16.4), height_m=250.0)
AIR = dict(pressure_hpa=990.0, air_temperature_c=12.0, humidity=0.6, wavelength_um=0.6)
SIZE = (752, 480)
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=375.5, cy_px=239.5, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                  image_size_px=SIZE, covariance=np.zeros((8, 8)))


def ground(pressure_hpa):
    return erfa.apco13(*UTC, 0.0, PLACE["longitude_rad"], PLACE["latitude_rad"], PLACE["height_m"], 0.0, 0.0, pressure_hpa,
                       AIR["air_temperature_c"], AIR["humidity"], AIR["wavelength_um"])[0]


def observed_on_the_ground(v, astrom):
    """ICRS directions (N, 3) without proper motion -> observed ones in axes north, east, zenith."""
    cirs = erfa.atciq(*sphere.radec_from_unit(v), 0.0, 0.0, 0.0, 0.0, astrom)
    azimuth, zenith_distance = erfa.atioq(*cirs, astrom)[:2]
    return np.stack([np.sin(zenith_distance) * np.cos(azimuth), np.sin(zenith_distance) * np.sin(azimuth),
                     np.cos(zenith_distance)], -1)


def deflected(v):
    earth_from_sun = erfa.epv00(*TT)[0]["p"]
    distance = np.linalg.norm(earth_from_sun)
    return erfa.ldsun(v, earth_from_sun / distance, distance)


def scattered(n, seed):
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def pairwise(v):
    return sphere.angle_between(v[:, None], v[None])


@pytest.mark.parametrize("pressure_hpa", [0.0, 990.0])
def test_the_ground_is_erfas(pressure_hpa):
    """Angles between the stars, which no choice of axes can hide, and their zenith distances, to below a milliarcsecond."""
    v = scattered(400, 41)
    seen = observed_on_the_ground(v, ground(pressure_hpa))
    up = seen[:, 2] > np.sin(np.radians(5.0))
    refraction = "erfa" if pressure_hpa else None
    observer = observer_at(DATE, Station(**PLACE, **(AIR | {"pressure_hpa": pressure_hpa}), refraction=refraction))
    ours = sphere.as_seen(deflected(v), observer)
    assert np.abs(pairwise(ours[up]) - pairwise(seen[up])).max() * ARCSEC < 1e-3
    if refraction:
        distance = sphere.angle_between(ours, observer.refraction.zenith_icrs)
        assert np.abs(distance - np.arccos(seen[:, 2]))[up].max() * ARCSEC < 1e-3


def test_orbit_is_erfas():
    velocity_km_s = (-5.1, 3.2, 4.6)
    astrom = erfa.apcs13(*TT, np.array((np.array([7e6, 0, 0]), np.array(velocity_km_s) * 1e3),
                                       dtype=[("p", float, 3), ("v", float, 3)]))
    v = scattered(200, 42)
    theirs = sphere.unit_from_radec(*erfa.atciq(*sphere.radec_from_unit(v), 0.0, 0.0, 0.0, 0.0, astrom))
    ours = sphere.as_seen(deflected(v), observer_at(DATE, Station(velocity_km_s=velocity_km_s)))
    assert sphere.angle_between(ours, theirs).max() * ARCSEC < 1e-3
    slow = sphere.as_seen(deflected(v), observer_at(DATE))
    assert 4 < sphere.angle_between(slow, theirs).max() * ARCSEC < 6


def test_bennett_is_near_erfa_and_undone_exactly():
    v = scattered(300, 43)
    erfas, bennett = (observer_at(DATE, Station(**PLACE, **AIR, refraction=name)) for name in ("erfa", "bennett"))
    altitude = np.pi / 2 - sphere.angle_between(v, erfas.refraction.zenith_icrs)
    for observer in (erfas, bennett):
        high = altitude > np.radians(3)
        back = sphere.as_catalogued(sphere.as_seen(v, observer), observer)
        assert sphere.angle_between(back, v)[high].max() * ARCSEC < 1e-4
    difference = sphere.angle_between(sphere.as_seen(v, erfas), sphere.as_seen(v, bennett)) * ARCSEC
    assert difference[altitude > np.radians(15)].max() < 6  # Bennett states 0.07 arcmin


def camera_sees(directions, truth, late_s=lambda xy: 0.0, rate=(0.0, 0.0, 0.0)):
    """Which of the directions fall on the frame, and their pixels; a row sees exp(-[rate] late) truth v."""
    xy = projection.project(LENS, directions @ truth.T)
    for _ in range(4):  # the row decides the instant, the instant the row
        turn = Rotation.from_rotvec(-np.asarray(late_s(np.nan_to_num(xy)))[..., None] * np.array(rate)).as_matrix()
        xy = projection.project(LENS, np.einsum("...ij,...j->...i", turn, directions @ truth.T))
    rows = np.flatnonzero(((xy > 0) & (xy < np.subtract(SIZE, 1))).all(1))
    return rows, xy[rows]


def solved(table, rows, xy, observer):
    """Attitude from matched stars and the catalogue direction of the image's centre, as the solver makes them."""
    m = len(rows)
    found = Identification(status="solved", method="", spot_rows=np.arange(m), star_rows=rows, xy_px=xy,
                           covariance_px2=np.tile(1e-6 * np.eye(2), (m, 1, 1)), direction_icrs=np.zeros((m, 3)),
                           intrinsics=LENS)
    attitude = find_attitude(as_observed(found, SkyCatalogue.seen_by(table, observer), observer), "q_method", calibrated=True)
    centre = projection.unproject(LENS, np.array([[(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]]))
    matrix = Rotation.from_quat(attitude.q_cam_icrs).as_matrix()
    return matrix, sphere.as_catalogued(centre @ matrix, observer)[0]


def turned_arcsec(matrix, truth):
    """Angle between two attitudes: what an effect that bends the whole field alike does, and which the centre's place hides."""
    return Rotation.from_matrix(matrix @ truth.T).magnitude() * ARCSEC


def centre_of(truth):
    return projection.unproject(LENS, np.array([[(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]]))[0] @ truth


def still(table):
    """The table without proper motion and parallax, at J2000."""
    zero = np.zeros(len(table))
    columns = {name: getattr(table, name) for name in table.__dataclass_fields__}
    return type(table)(**(columns | {"epoch_jyear": 2000.0, "pm_ra_mas_yr": zero, "pm_dec_mas_yr": zero, "parallax_mas": zero}))


def test_ground_frame_costs_without_refraction_and_place_and_is_exact_with_them():
    table = still(load_star_table())
    v = sphere.unit_from_radec(table.ra_rad, table.dec_rad)
    astrom = ground(AIR["pressure_hpa"])
    seen = observed_on_the_ground(v, astrom)
    for azimuth_deg, altitude_deg, cost in ((80.0, 35.0, 79.0), (200.0, 55.0, 38.5)):
        # axes north, east, zenith are left-handed: turned about by looking at them as (north, west, zenith)
        truth = sphere.camera_pointing_at(-np.radians(azimuth_deg), np.radians(altitude_deg), 0.3)
        flip = np.diag([1.0, -1, 1])
        rows, xy = camera_sees(seen @ flip, truth)
        u = centre_of(truth) @ flip
        cirs = erfa.atoiq("A", np.arctan2(u[1], u[0]), np.arccos(u[2]), astrom)
        expected = sphere.unit_from_radec(*erfa.aticq(*cirs, astrom))
        right = observer_at(DATE, Station(**PLACE, **AIR, refraction="erfa"))
        airless, centre = observer_at(DATE, Station(**PLACE)), observer_at(DATE)
        bennett = observer_at(DATE, Station(**PLACE, **AIR, refraction="bennett"))
        matrix, place = solved(table, rows, xy, right)
        assert sphere.angle_between(place, expected) * ARCSEC < 0.03  # of which 0.01 is light deflection
        assert turned_arcsec(solved(table, rows, xy, airless)[0], matrix) == pytest.approx(cost, rel=0.2)  # with roll
        assert turned_arcsec(solved(table, rows, xy, centre)[0], solved(table, rows, xy, airless)[0]) > 0.1
        assert turned_arcsec(solved(table, rows, xy, bennett)[0], matrix) < 5


def test_each_motion_costs_what_is_stated_and_is_recovered():
    """Velocity in orbit, place on the ground, proper motion of 25 years, parallax, aberration of the year."""
    table = load_star_table()
    rng = np.random.default_rng(44)
    orbit = Station(velocity_km_s=(-5.1, 3.2, 4.6))
    right, year = observer_at(DATE, orbit), observer_at(DATE)
    place = observer_at(DATE, Station(**PLACE))
    costs = {"orbit": [], "diurnal": [], "year": [], "motion": []}
    for _ in range(20):
        truth = Rotation.random(random_state=rng).as_matrix()
        for observer, without, name in ((right, year, "orbit"), (place, year, "diurnal"), (year, Observer(), "year")):
            rows, xy = camera_sees(star_directions(table, observer), truth)
            assert turned_arcsec(solved(table, rows, xy, observer)[0], truth) < 0.01
            costs[name].append(turned_arcsec(solved(table, rows, xy, without)[0], truth))
        rows, xy = camera_sees(star_directions(table, year), truth)
        costs["motion"].append(turned_arcsec(solved(still(table), rows, xy, year)[0], truth))
    assert 3 < max(costs["orbit"]) < 5.3
    assert 0.1 < max(costs["diurnal"]) < 0.32
    assert 15 < max(costs["year"]) < 22
    assert max(costs["motion"]) > 0.5


@pytest.mark.parametrize("readout", ["down", "up"])
def test_rolling_shutter(readout):
    """1 degree a second across 480 rows of 31.75 us: up to 27 arcsec between a row and the middle one."""
    table = still(load_star_table())
    rate, row_time_s = np.radians([0.6, 0.5, 2.0]), 3.175e-5
    frame = Frame(data=np.zeros(SIZE[::-1], np.uint16), bit_depth=10, white_level_dn=1023.0, date_obs=DATE, exposure_s=0.02,
                  station=Station(row_time_s=row_time_s, readout=readout, rate_rad_s=tuple(rate)))
    observer = frame_observer(frame)
    assert observer.time_utc == "2024-05-17T21:04:05.017604"  # start + half the exposure + 239.5 rows
    sign = 1 if readout == "down" else -1
    still_camera = Observer(**(vars(observer) | {"rolling": None}))
    worst = 0.0
    for seed in range(10):
        truth = Rotation.random(random_state=seed).as_matrix()
        rows, xy = camera_sees(star_directions(table, still_camera), truth, rate=rate,
                               late_s=lambda xy: (xy[:, 1] - 239.5) * sign * row_time_s)
        few = np.argsort(xy[:, 1])[:8]  # stars at the top of the image: the drift has no other side to cancel on
        assert turned_arcsec(solved(table, rows[few], xy[few], observer)[0], truth) < 0.01
        worst = max(worst, turned_arcsec(solved(table, rows[few], xy[few], still_camera)[0], truth))
    assert worst > 10
