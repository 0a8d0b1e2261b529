"""Identification on synthetic spots: an independent draw of sky, noise, false and missing stars."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench import registry
from calibench.errors import UsageError
from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer, Spots
from calibench.stars.frame_attitude import find_attitude
from calibench.stars.lost_in_space import ACCEPT, LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE = (752, 480)
METHODS = registry.names("calibench.stars.identify")


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    table = load_star_table()
    return SkyCatalogue.seen_by(table.take(table.hp_mag <= 6.0), Observer())


def thesis_lens(**changes) -> Intrinsics:
    values = dict(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=375.5, cy_px=239.5, distortion=[-0.05, 0.0, 0.0, 0.0],
                  image_size_px=SIZE, covariance=np.diag([0.2, 0.2, 0.2, 0.2, 1e-6, 1e-6, 1e-10, 1e-10]))
    return Intrinsics(**(values | changes))


def spots_of(xy, magnitude, sigma) -> Spots:
    order = np.argsort(magnitude)
    n = len(order)
    return Spots(xy_px=xy[order], covariance_px2=np.tile(np.eye(2) * sigma**2, (n, 1, 1)),
                 flux_e=10 ** (-0.4 * magnitude[order]), background_dn=np.zeros(n),
                 peak_dn=np.zeros(n), pixels=np.zeros(n), flags=np.zeros(n))


def look(sky, lens, rng, *, sigma=0.2, false=0, missing=0.0):
    """A random attitude and what the camera sees there."""
    truth = Rotation.random(random_state=rng).as_matrix()
    xy = projection.project(lens, sky.directions @ truth.T)
    on = ((xy > 0) & (xy < np.subtract(SIZE, 1))).all(1) & (rng.random(len(xy)) >= missing)
    xy, magnitude = xy[on] + rng.normal(0, sigma, (on.sum(), 2)), sky.magnitude[on] + rng.normal(0, 0.2, on.sum())
    xy = np.concatenate([xy, rng.uniform(0, SIZE, (false, 2))])
    magnitude = np.concatenate([magnitude, rng.uniform(2, 6, false)])
    return truth, spots_of(xy, magnitude, sigma)


def boresight_error_deg(found, truth, method="quest"):
    attitude = find_attitude(found, method, calibrated=True)
    matrix = Rotation.from_quat(attitude.q_cam_icrs).as_matrix()
    return np.degrees(Rotation.from_matrix(matrix @ truth.T).magnitude())


# What each method must reach of 25 attitudes; none may ever be wrong.
@pytest.mark.parametrize(("method", "stress", "least"), [
    ("pattern", {}, 25), ("pattern", {"false": 5, "missing": 0.3}, 24), ("pyramid", {}, 25),
    ("pyramid", {"false": 5, "missing": 0.3}, 23), ("area_polar_moment", {}, 22)])
def test_known_lens(sky, method, stress, least):
    rng, finder, lens = np.random.default_rng(11), LostInSpace(sky=sky, method=method), thesis_lens()
    solved = 0
    for _ in range(25):
        truth, spots = look(sky, lens, rng, **stress)
        found = finder.identify(spots, SIZE, lens=lens)
        if found.status == "solved":
            assert found.false_match_probability < ACCEPT
            assert boresight_error_deg(found, truth) < 0.05
            solved += 1
    assert solved >= least


@pytest.mark.parametrize("fov_given", [True, False])
def test_unknown_lens_is_fitted(sky, fov_given):
    rng, finder, lens = np.random.default_rng(12), LostInSpace(sky=sky), thesis_lens(distortion=[-0.12, 0.05, 0, 0])
    for _ in range(4):
        truth, spots = look(sky, lens, rng, sigma=0.1)
        found = finder.identify(spots, SIZE, fov_rad=np.radians(28.5) if fov_given else None)
        assert found.status == "solved"
        assert found.intrinsics.fx_px == pytest.approx(1416.7, rel=0.003)
        assert boresight_error_deg(found, truth) < 0.05


@pytest.mark.parametrize("fov_deg", [6, 15, 35, 55])
def test_every_field_size_is_tried(fov_deg):
    """The full table: a narrow field needs the faint stars."""
    sky = SkyCatalogue.seen_by(load_star_table(), Observer())
    lens = thesis_lens(fx_px=376 / np.tan(np.radians(fov_deg / 2)), fy_px=376 / np.tan(np.radians(fov_deg / 2)),
                       distortion=[0, 0, 0, 0])
    rng, finder = np.random.default_rng(13), LostInSpace(sky=sky)
    done = 0
    for _ in range(3):
        truth, spots = look(sky, lens, rng, sigma=0.1)
        found = finder.identify(spots.take(np.arange(min(len(spots), 60))), SIZE)
        if found.status == "solved":
            assert boresight_error_deg(found, truth) < 0.1
            done += 1
    assert done >= 2


@pytest.mark.parametrize("terms", [(-0.45, 0.0), (-0.37, 0.31)])
def test_strong_distortion_without_a_map(sky, terms):
    """A field of 60 degrees whose corners are 10 to 20 % nearer to the centre, mirrored, with false and missing stars."""
    focal = 376 / (np.tan(np.radians(30)) * (1 + terms[0] / 3 + terms[1] / 9))
    lens = thesis_lens(fx_px=focal, fy_px=focal, distortion=[*terms, 0, 0], mirrored=True)
    rng, finder, solved = np.random.default_rng(17), LostInSpace(sky=sky), 0
    for _ in range(8):
        truth, spots = look(sky, lens, rng, sigma=0.15, false=5, missing=0.3)
        found = finder.identify(spots.take(np.arange(25)), SIZE, fov_rad=np.radians(56))
        if found.status == "solved":
            assert found.intrinsics.mirrored and boresight_error_deg(found, truth) < 0.2  # 2 px
            solved += 1
    assert solved >= 7


def test_a_mirrored_image_is_found_and_said(sky):
    rng = np.random.default_rng(14)
    lens = thesis_lens(mirrored=True, distortion=[0, 0, 0, 0])
    truth, spots = look(sky, lens, rng, sigma=0.05)
    found = LostInSpace(sky=sky).identify(spots, SIZE, fov_rad=np.radians(29.7))
    assert found.status == "solved" and found.intrinsics.mirrored
    assert boresight_error_deg(found, truth) < 0.05


@pytest.mark.parametrize("method", METHODS)
def test_random_spots_are_never_solved(sky, method):
    rng, finder, lens = np.random.default_rng(15), LostInSpace(sky=sky, method=method), thesis_lens()
    for _ in range(15):
        n = int(rng.integers(5, 30))
        found = finder.identify(spots_of(rng.uniform(0, SIZE, (n, 2)), rng.uniform(2, 6, n), 0.2), SIZE, lens=lens)
        assert found.status in ("no_match", "rejected")
        assert found.reason and found.false_match_probability >= ACCEPT


def test_a_wrong_focal_length_is_suspected(sky):
    truth, spots = look(sky, thesis_lens(), np.random.default_rng(16))
    found = LostInSpace(sky=sky).identify(spots, SIZE, lens=thesis_lens(fx_px=1250.0, fy_px=1250.0))
    assert found.status != "solved" and "lens" in found.reason


def test_too_few_spots_say_so(sky):
    found = LostInSpace(sky=sky).identify(spots_of(np.ones((2, 2)), np.ones(2), 0.2), SIZE, lens=thesis_lens())
    assert found.status == "too_few_spots" and "2 spots" in found.reason


def test_an_unknown_method_answers_with_the_known_ones(sky):
    with pytest.raises(UsageError, match="pattern.*pyramid"):
        LostInSpace(sky=sky, method="stars").identify(spots_of(np.ones((9, 2)), np.ones(9), 0.2), SIZE, lens=thesis_lens())


def test_sky_directions_are_astropys():
    """Proper motion over 25 years and aberration, against astropy's own transformation of the same catalogue entries."""
    import astropy.units as u
    from astropy.coordinates import GCRS, SkyCoord
    from astropy.time import Time

    from calibench.geometry import sphere
    from calibench.io.observer import observer_at
    from calibench.stars.sky_catalogue import star_directions
    table = load_star_table()
    table = table.take(np.isin(table.hip, [69673, 71683, 32349, 91262, 11767]))
    date = "2026-03-01T00:00:00"
    # The positions move along great circles; astropy is given a distance for every star, so that its motion is plain.
    coordinates = SkyCoord(table.ra_rad * u.rad, table.dec_rad * u.rad, pm_ra_cosdec=table.pm_ra_mas_yr * u.mas / u.yr,
                           pm_dec=table.pm_dec_mas_yr * u.mas / u.yr, distance=np.full(len(table), 1e3) * u.pc,
                           radial_velocity=np.zeros(len(table)) * u.km / u.s, obstime=Time(1991.25, format="jyear"))
    moved = coordinates.apply_space_motion(new_obstime=Time(date))
    here = star_directions(table, Observer(epoch_jyear=Time(date).jyear))
    theirs = sphere.unit_from_radec(moved.ra.rad, moved.dec.rad)
    assert np.degrees(sphere.angle_between(here, theirs)).max() * 3600 < 0.01
    seen = star_directions(table, observer_at(date))
    gcrs = SkyCoord(moved.ra, moved.dec, distance=1e6 * u.pc).transform_to(GCRS(obstime=Time(date)))
    theirs = sphere.unit_from_radec(gcrs.ra.rad, gcrs.dec.rad)
    # parallax (0.75 arcsec for HIP 71683) is in ours only; light deflection by the Sun (to 0.02 arcsec here) in theirs only
    assert np.degrees(sphere.angle_between(seen, theirs)).max() * 3600 < 0.85
