"""Rendered stars against astropy's sky and OpenCV's lens, and the photometry against a measurement on the frame."""

from __future__ import annotations

import astropy.units as u
import cv2
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time

from calibench.geometry.sphere import camera_pointing_at
from calibench.records import Observer, StarTable
from calibench.simulate.camera import stream, thesis_camera
from calibench.simulate.photometry import sky_electrons_per_s, star_electrons_per_s
from calibench.simulate.starfield import SkyConditions, apparent_directions, star_field

CAMERA = thesis_camera(1)
DARK_SKY = SkyConditions(sky_mag_arcsec2=30.0)
POINTING_DEG = np.array([83.0, -2.0, 25.0])


def table(ra_deg: list[float], dec_deg: list[float], v_mag: list[float], pm: tuple[float, float] = (0.0, 0.0)) -> StarTable:
    n = len(ra_deg)
    return StarTable(epoch_jyear=1991.25, hip=np.arange(1, n + 1), hr=np.zeros(n, int), ra_rad=np.radians(ra_deg),
                     dec_rad=np.radians(dec_deg), pm_ra_mas_yr=np.full(n, pm[0]), pm_dec_mas_yr=np.full(n, pm[1]),
                     parallax_mas=np.full(n, np.nan), hp_mag=np.array(v_mag), v_mag=np.array(v_mag), b_v=np.zeros(n),
                     spectral_type=np.array([""] * n))


def astropy_pixels(coordinates: SkyCoord) -> np.ndarray:
    """Tangent-plane position from astropy's offset frame (lon to the east, lat along image up), lens by OpenCV."""
    ra, dec, roll = POINTING_DEG * u.deg
    offset = coordinates.transform_to(SkyCoord(ra, dec, frame="icrs").skyoffset_frame(rotation=roll))
    east, up, ahead = offset.cartesian.y.value, offset.cartesian.z.value, offset.cartesian.x.value
    points = np.column_stack([-east, -up, ahead])  # x right is west when up is north; y down
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA.intrinsics.camera_matrix,
                             CAMERA.intrinsics.distortion)[0][:, 0]


def field_of(stars: StarTable, observer: Observer | None = None, conditions: SkyConditions = DARK_SKY):
    return star_field(CAMERA, stars, camera_pointing_at(*np.radians(POINTING_DEG)), exposure_s=0.2, conditions=conditions,
                      observer=observer or Observer(), rng=stream(4))


def test_stars_fall_where_astropy_and_opencv_put_them():
    ra, dec = [83.0, 88.8, 78.6, 81.3, 90.0], [-2.0, 2.4, -8.2, 6.35, -6.3]
    field = field_of(table(ra, dec, [0.0, 1.0, 2.0, 3.0, 4.0]))
    assert field.star_rows.tolist() == [0, 1, 2, 3, 4]
    assert np.abs(field.xy_px - astropy_pixels(SkyCoord(ra * u.deg, dec * u.deg))).max() < 1e-6


@pytest.mark.filterwarnings("ignore:ERFA")  # no distance given, none needed
def test_proper_motion_follows_astropy():
    stars = table([84.0, 80.0], [1.0, -5.0], [3.0, 3.0], pm=(-3826.0, 1337.0))
    field = field_of(stars, Observer(epoch_jyear=2025.5))
    moving = SkyCoord([84.0, 80.0] * u.deg, [1.0, -5.0] * u.deg, pm_ra_cosdec=[-3826.0] * 2 * u.mas / u.yr,
                      pm_dec=[1337.0] * 2 * u.mas / u.yr, obstime=Time(1991.25, format="jyear", scale="tdb"))
    there = moving.apply_space_motion(new_obstime=Time(2025.5, format="jyear", scale="tdb"))
    expected = astropy_pixels(SkyCoord(there.ra, there.dec))
    assert np.abs(field.xy_px - expected[field.star_rows]).max() < 2e-3
    assert np.abs(field.xy_px - astropy_pixels(SkyCoord(moving.ra, moving.dec))[field.star_rows]).max() > 0.5


def test_aberration_is_twenty_arcsec_at_right_angles_to_the_motion():
    stars = table([90.0], [0.0], [1.0])
    moving = apparent_directions(stars, Observer(epoch_jyear=1991.25, velocity_c=np.array([1e-4, 0.0, 0.0])))
    assert moving[0] == pytest.approx([1e-4, 1.0, 0.0], abs=1e-8)


def test_flux_on_the_frame_is_that_of_the_zero_point():
    field = field_of(table([83.0], [-2.0], [5.0]))
    # 1000 photons/s/cm^2/A, 3500 A, a pupil of 8.5/1.3 mm, 80 % of glass, 40 % of silicon; on the axis.
    expected = 1000 * 3500 * np.pi / 4 * (0.85 / 1.3) ** 2 * 0.8 * 0.4 * 10 ** (-0.4 * 5.0) * 0.2
    assert star_electrons_per_s(CAMERA, 5.0) * 0.2 == pytest.approx(expected)
    x, y = np.rint(field.xy_px[0]).astype(int)
    assert field.light_e[y - 9:y + 10, x - 9:x + 10].sum() == pytest.approx(expected, rel=0.01)


def test_background_fills_every_pixel_with_the_sky_of_its_solid_angle():
    field = field_of(table([], [], []), conditions=SkyConditions(sky_mag_arcsec2=20.0))
    pixel_arcsec = np.degrees(6e-3 / 8.5) * 3600
    per_s = star_electrons_per_s(CAMERA, 20.0) * pixel_arcsec**2
    assert sky_electrons_per_s(CAMERA, 20.0) == pytest.approx(per_s)
    assert field.light_e[237, 380] == pytest.approx(0.2 * per_s, rel=0.01)
    assert field.light_e[2, 2] < 0.85 * field.light_e[237, 380]


def test_coma_is_in_the_truth_and_in_the_picture():
    field = field_of(table([94.5], [3.0], [2.0]))
    assert len(field.xy_px) == 1
    rows, cols = np.mgrid[:480, :752]
    light = field.light_e - field.light_e.min()
    light[np.hypot(cols - field.xy_px[0, 0], rows - field.xy_px[0, 1]) > 9] = 0
    centroid = np.array([(light * cols).sum(), (light * rows).sum()]) / light.sum()
    assert centroid == pytest.approx(field.xy_px[0], abs=0.01)
    assert np.hypot(*(field.chief_ray_px[0] - field.xy_px[0])) > 0.1


def test_stars_off_the_image_behind_the_camera_or_without_magnitude_give_no_light():
    field = field_of(table([83.0, 263.0, 120.0, 84.0], [-2.0, 2.0, 0.0, -2.0], [3.0, 0.0, 0.0, np.nan]))
    assert field.star_rows.tolist() == [0]


def test_false_stars_and_cosmic_hits_are_added_and_told():
    empty = table([], [], [])
    plain = field_of(empty).light_e
    field = field_of(empty, conditions=SkyConditions(sky_mag_arcsec2=30.0, false_stars=3, cosmic_hits=4))
    added = field.light_e - plain
    assert len(field.false_xy_px) == 3 and len(field.cosmic_xy_px) == 4
    for x, y in np.rint(field.false_xy_px).astype(int):
        assert added[max(y - 2, 0):y + 3, max(x - 2, 0):x + 3].sum() > 300
    for x, y in np.rint(field.cosmic_xy_px).astype(int):
        assert added[y, x] > 10
