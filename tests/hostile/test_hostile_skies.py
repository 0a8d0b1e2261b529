"""Skies that are not only stars, as lists of spots: solved rightly, or a status with its reason; never a wrong attitude."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer, Spots
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE = (752, 480)
LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=SIZE, focal_sd_px=0.3)


@pytest.fixture(scope="module")
def finder() -> LostInSpace:
    table = load_star_table()
    return LostInSpace(sky=SkyCatalogue.seen_by(table.take(table.hp_mag <= 6), Observer()))


def spots_at(xy, sigma_px=0.2) -> Spots:
    nothing = np.zeros(len(xy))
    return Spots(xy_px=xy, covariance_px2=np.tile(np.eye(2) * sigma_px**2, (len(xy), 1, 1)), flux_e=nothing,
                 background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing)


def stars_seen(finder, rng, lens=LENS) -> tuple[np.ndarray, np.ndarray]:
    """A random attitude and its stars (N, 2) px, brightest first."""
    truth = Rotation.random(random_state=rng).as_matrix()
    rows = np.flatnonzero(finder.sky.directions @ truth[2] > 0.9)
    xy = projection.project(lens, finder.sky.directions[rows] @ truth.T)
    xy = xy[((xy > 0) & (xy < np.subtract(SIZE, 1))).all(1)]
    return truth, xy + rng.normal(0, 0.2, xy.shape)


def right_or_said(found, truth) -> bool:
    """Whether it was solved; a wrong answer or one without reason fails."""
    if found.status != "solved":
        assert found.reason and found.false_match_probability >= 1e-6
        return False
    off = projection.project(found.intrinsics, found.direction_icrs @ truth.T) - found.xy_px
    assert np.median(np.hypot(*off.T)) < 1
    return True


def hot_pixels(xy, rng):
    return np.concatenate([rng.uniform(0, SIZE, (12, 2)), xy, rng.uniform(0, SIZE, (400, 2))])  # a dozen outshine the stars


def planets_and_a_satellite(xy, rng):
    trail = rng.uniform(100, 300, 2) + np.outer(np.arange(8), (31.0, 17.0))
    return np.concatenate([rng.uniform(0, SIZE, (3, 2)), trail, xy])


def clouds_on_half(xy, rng):
    return xy[xy[:, 0] < SIZE[0] / 2]


def trees(xy, rng):
    edge = np.stack([rng.uniform(0, 752, 60), 330 + rng.normal(0, 8, 60)], -1)
    return np.concatenate([edge[:8], xy[xy[:, 1] < 320], edge[8:]])


def a_moon(xy, rng):
    ring = 60 * np.stack([np.cos(np.arange(20)), np.sin(np.arange(20))], -1) + (376, 240) + rng.normal(0, 3, (20, 2))
    return np.concatenate([ring, xy[np.hypot(*(xy - (376, 240)).T) > 120]])


@pytest.mark.parametrize(("scene", "least"), [(hot_pixels, 9), (planets_and_a_satellite, 9), (clouds_on_half, 9), (trees, 9),
                                              (a_moon, 9)])
def test_what_is_no_star_does_not_mislead(finder, scene, least):
    rng, solved = np.random.default_rng(50), 0
    for _ in range(10):
        truth, xy = stars_seen(finder, rng)
        solved += right_or_said(finder.identify(spots_at(scene(xy, rng)), SIZE, lens=LENS), truth)
    assert solved >= least


def test_a_saturated_field_or_a_regular_grid_is_no_sky(finder):
    grid = np.stack(np.meshgrid(np.arange(20, 752, 60.0), np.arange(20, 480, 60.0)), -1).reshape(-1, 2)
    line = np.stack([np.linspace(5, 740, 30), np.full(30, 200.0)], -1)
    one_place = np.full((30, 2), 240.0)
    for xy in (grid, line, one_place, one_place + np.random.default_rng(1).normal(0, 0.3, (30, 2))):
        found = finder.identify(spots_at(xy), SIZE, lens=LENS)
        assert found.status in ("no_match", "rejected") and found.reason


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_too_few_spots(finder, n):
    found = finder.identify(spots_at(np.random.default_rng(n).uniform(0, 400, (n, 2))), SIZE, lens=LENS)
    assert found.status == "too_few_spots" and f"{n} spots" in found.reason


def test_a_wrong_pixel_size_is_suspected(finder):
    rng = np.random.default_rng(51)
    for _ in range(3):
        truth, xy = stars_seen(finder, rng)
        wrong = Intrinsics.pinhole(focal_px=1416.7 * 5.2 / 6, image_size_px=SIZE, focal_sd_px=0.3)
        found = finder.identify(spots_at(xy), SIZE, lens=wrong)
        assert found.status != "solved" and "lens" in found.reason


def test_a_lens_that_drifted_is_still_solved(finder):
    rng, solved = np.random.default_rng(52), 0
    drifted = Intrinsics.pinhole(focal_px=1416.7 * 1.0015, image_size_px=SIZE, focal_sd_px=0.3)
    for _ in range(5):
        truth, xy = stars_seen(finder, rng, drifted)
        solved += right_or_said(finder.identify(spots_at(xy), SIZE, lens=LENS), truth)
    assert solved == 5
