"""The contract of every registered identifier: what it solves through a known lens, and that it is never wrong."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.spatial.transform import Rotation

from calibench import registry
from calibench.geometry import projection, sphere
from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer, Spots
from calibench.stars.identify import (
    _features,
    _neighbourhoods,
    _votes,
    liebe,
    oriented_triangles,
    planar_triangle,
    spherical_triangle,
)
from calibench.stars.k_vector import KVectorPairs, LinearPairs
from calibench.stars.lost_in_space import ACCEPT, LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.star_pairs import StarPairs
from calibench.stars.view import KnownLens

SIZE = (752, 480)
SIGMA_PX = 0.2
METHODS = registry.names("calibench.stars.identify")
LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=SIZE, focal_sd_px=0.0)


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    table = load_star_table()
    return SkyCatalogue.seen_by(table.take(table.hp_mag <= 6.0), Observer())


def spots_of(xy: np.ndarray) -> Spots:
    nothing = np.zeros(len(xy))
    return Spots(xy_px=xy, covariance_px2=np.tile(np.eye(2) * SIGMA_PX**2, (len(xy), 1, 1)), flux_e=nothing,
                 background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing)


def look(sky, rng, *, false=0, missing=0.0) -> tuple[np.ndarray, Spots]:
    """A random attitude and the spots there, brightest first, the false ones among them."""
    truth = Rotation.random(random_state=rng).as_matrix()
    xy = projection.project(LENS, sky.directions @ truth.T)
    xy = xy[((xy > 0) & (xy < np.subtract(SIZE, 1))).all(1)]
    xy = xy[rng.random(len(xy)) >= missing] + 0.0
    xy += rng.normal(0, SIGMA_PX, xy.shape)
    return truth, spots_of(np.insert(xy, rng.integers(0, len(xy), false), rng.uniform(0, SIZE, (false, 2)), axis=0))


def is_right(found, truth) -> bool:
    there = projection.project(LENS, found.direction_icrs @ truth.T)
    return np.hypot(*(there - found.xy_px).T).max() < 8 * SIGMA_PX and found.false_match_probability < ACCEPT


@pytest.mark.parametrize("method", METHODS)
def test_clean_and_spoilt_frames(sky, method):
    rng, finder, solved = np.random.default_rng(21), LostInSpace(sky=sky, method=method), [0, 0]
    for stressed in (0, 1):
        for _ in range(10):
            truth, spots = look(sky, rng, false=3 * stressed, missing=0.2 * stressed)
            found = finder.identify(spots, SIZE, lens=LENS)
            if found.status == "solved":
                assert is_right(found, truth)
                solved[stressed] += 1
    assert solved[0] >= 9 and solved[1] >= 7


@pytest.mark.parametrize("method", METHODS)
def test_nothing_few_alike_and_mirrored(sky, method):
    """Random spots, too few, spots in one place, and a frame that the driver mirrored: a status, never a wrong answer."""
    rng, finder = np.random.default_rng(22), LostInSpace(sky=sky, method=method)
    for n in (5, 9):
        found = finder.identify(spots_of(rng.uniform(0, SIZE, (n, 2))), SIZE, lens=LENS)
        assert found.status in ("no_match", "rejected") and found.reason
    assert finder.identify(Spots.none(), SIZE, lens=LENS).status == "too_few_spots"
    for crowded in (np.full((6, 2), 100.0), np.linspace((10, 10), (700, 400), 7), rng.normal(5, 1e-3, (4, 2))):
        assert finder.identify(spots_of(crowded), SIZE, lens=LENS).status != "solved"
    truth, spots = look(sky, rng)
    flipped = spots_of(spots.xy_px * (-1, 1) + (SIZE[0] - 1, 0))
    found = finder.identify(flipped, SIZE, lens=LENS)
    assert found.status != "solved" or found.intrinsics.mirrored


@pytest.mark.parametrize("field_deg", [6.0, 30.0])
def test_every_search_finds_the_pairs_of_bisection(sky, field_deg):
    pairs = StarPairs.build(sky, np.radians(field_deg) / 2)
    angle = pairs.angle_rad
    line, parabola = KVectorPairs.of(pairs, quadratic=False), KVectorPairs.of(pairs, quadratic=True)
    rng, looked_at = np.random.default_rng(23), np.zeros(2)
    low = np.concatenate([rng.uniform(angle[0] - 0.01, angle[-1] + 0.01, 300), rng.choice(angle, 100), angle[[0, -1]], [-1]])
    for one, width in zip(low, np.append(rng.choice([0, 1e-5, 1e-3, 0.1], len(low) - 1), 9), strict=True):
        i, j = np.searchsorted(angle, one), np.searchsorted(angle, one + width, "right")
        for table in (LinearPairs(*pairs), line, parabola):
            first, second = table.between(one, one + width)
            np.testing.assert_array_equal(first, pairs.first[i:j])
            np.testing.assert_array_equal(second, pairs.second[i:j])
        looked_at += [np.subtract(*table.rows(one, one + width)[::-1]) - (j - i) for table in (line, parabola)]
    assert (looked_at < 1.5 * len(low)).all()  # of the line and of the parabola: hardly a row in vain


@pytest.mark.parametrize("values", [[], [0.1], [0.1, 0.1], [0.1, 0.2, 0.2], [0.0, 0.9, 0.99, 1.0], [0.0, 0.01, 0.02, 1.0]])
@pytest.mark.parametrize("quadratic", [False, True])
def test_k_vectors_of_few_and_of_crooked_values(values, quadratic):
    rows = np.arange(len(values))
    table = KVectorPairs.of(StarPairs(np.array(values), rows, rows), quadratic=quadratic)
    for low in (-1, 0, 0.1, 0.15, 0.2, 0.99, 1, 2):
        for high in (low, low + 0.05, low + 3):
            wanted = [k for k, value in enumerate(values) if low <= value <= high]
            assert table.between(low, high)[0].tolist() == wanted


def test_spherical_area_and_moment_are_those_of_integration():
    corners = sphere.unit_from_radec(np.radians([0, 18, 5]), np.radians([0, 4, 15]))
    area, moment = spherical_triangle.area_and_moment(corners)
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    height, twice = a @ normal / np.linalg.norm(normal), np.linalg.norm(normal)

    def over(value):
        def at(v, u):
            p = a + u * (b - a) + v * (c - a)
            return value(p / np.linalg.norm(p)) * twice * abs(height) / np.linalg.norm(p) ** 3
        return dblquad(at, 0, 1, 0, lambda u: 1 - u, epsabs=1e-10)[0]
    middle = np.array([over(lambda p, k=k: p[k]) for k in range(3)])
    middle /= np.linalg.norm(middle)
    assert area == pytest.approx(over(lambda p: 1.0), rel=1e-8)
    assert moment == pytest.approx(over(lambda p: np.arccos(min(p @ middle, 1)) ** 2), rel=1e-4)


@pytest.mark.parametrize("method", [planar_triangle, spherical_triangle, oriented_triangles, liebe])
def test_tolerances_are_four_sigma_of_drawn_noise(method):
    rng = np.random.default_rng(24)
    view = KnownLens(LENS).view(spots_of(np.array([[100.0, 80.0], [600.0, 150.0], [320.0, 420.0]])))
    corners = np.array([[0, 1, 2]])
    noisy = view.directions + rng.normal(0, 1, (4000, 3, 3)) * view.sigma_rad[:, None]
    drawn = method.code(noisy / np.linalg.norm(noisy, axis=-1, keepdims=True)).std(0)
    stated = _features.tolerance(view, corners, method.code)[0]
    assert (stated > 3.8 * drawn).all() and (stated < 7 * drawn + 4e-4).all()


def test_planar_angles_and_liebes_angle():
    small = sphere.unit_from_radec(np.radians([0, 0.04, 0]), np.radians([0, 0, 0.03]))  # a right angle at corner 0; 3, 4, 5
    np.testing.assert_allclose(np.degrees(liebe.code(small[[0, 2, 1]])), [0.03, 0.04, 90], rtol=1e-6)
    at_0, at_1, side = planar_triangle.code(small[[1, 2, 0]])
    np.testing.assert_allclose(np.degrees([at_0, at_1, side]), [36.8699, 53.1301, 0.05], rtol=1e-5)


def test_turning_tells_a_triangle_from_its_mirror_image(sky):
    rows = _features.triangles(sky, 0.2)[:200]
    turned = oriented_triangles.turning(sky.directions, rows)
    assert (np.linalg.det(sky.directions[turned]) > 0).all()
    sides = oriented_triangles.code(sky.directions[turned])
    assert (sides.argmax(1) == 0).all()
    mirror = sky.directions * (1, 1, -1)
    seen = oriented_triangles.code(mirror[oriented_triangles.turning(mirror, rows)])
    np.testing.assert_allclose(seen, sides[:, [0, 2, 1]])


def test_neighbourhoods_turn_alike_in_camera_and_sky(sky):
    turn = Rotation.random(random_state=25).as_matrix()
    stars = sky.directions[:300]
    here, there = (_neighbourhoods.neighbourhoods(v, 0.4) for v in (stars, stars @ turn.T))
    brute = {(i, j) for i in range(300) for j in np.flatnonzero(stars @ stars[i] > np.cos(0.4)) if i != j}
    assert set(zip(here.pole, here.neighbour, strict=True)) == brute
    for pole in (0, 7, 123):
        a, b = here.of(pole), there.of(pole)
        np.testing.assert_array_equal(a.neighbour, b.neighbour)
        np.testing.assert_allclose(a.distance_rad, b.distance_rad, atol=1e-12)
        turned = np.angle(np.exp(1j * (a.azimuth_rad - b.azimuth_rad)))
        np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * turned[0]), atol=1e-9)
        assert (np.diff(a.distance_rad) >= 0).all()


def test_those_who_agree_with_most_are_proposed_first(sky):
    rng = np.random.default_rng(26)
    stars = sky.near(sky.directions[3], 0.12)[:5]
    turn = Rotation.align_vectors([[0, 0, 1.0]], [sky.directions[3]])[0]
    view = KnownLens(LENS).view(spots_of(projection.project(LENS, turn.apply(sky.directions[stars]))))
    spot = np.concatenate([np.arange(5), np.arange(5)])
    star = np.concatenate([stars, rng.choice(np.setdiff1d(np.arange(900), stars), 5)])
    spots, proposed = next(_votes.agreeing_triples(view, sky, spot, star))
    assert len(spots) >= 3 and (stars[spots[:3]] == proposed[:3]).all()
    assert _votes.most_voted(np.array([0, 3, 1, 7, 2])).tolist() == [3, 1, 4]
