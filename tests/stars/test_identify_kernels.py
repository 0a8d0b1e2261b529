"""The compiled bricks of identification against plain numpy and scipy."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from calibench.geometry import kernels as geometry
from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import DISTORTION_NAMES, Intrinsics, Observer, Spots
from calibench.stars import kernels
from calibench.stars.code_table import CodeTable
from calibench.stars.guess import kernels as guess
from calibench.stars.identify import kernels as identify
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.view import KnownLens

SIZE = (752, 480)
TERMS = (-0.2, 0.05, 1e-3, -5e-4, 0.01, 0.1, 0.01, 0.002, 1e-3, -2e-4, 5e-4, 1e-4)


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    return SkyCatalogue.seen_by(load_star_table(), Observer())


def lens_of(model: str, **changes) -> Intrinsics:
    n = len(DISTORTION_NAMES[model])
    values = dict(model=model, fx_px=700.0, fy_px=705.0, cx_px=370.0, cy_px=243.0, image_size_px=SIZE,
                  distortion=TERMS[:n], covariance=np.diag([0.3, 0.3, 0.2, 0.2, *[1e-6] * n]))
    return Intrinsics(**(values | changes))


def spots_of(xy, rng) -> Spots:
    n = len(xy)
    root = rng.normal(0, 0.2, (n, 2, 2))
    nothing = np.zeros(n)
    return Spots(xy_px=xy, covariance_px2=root @ np.swapaxes(root, 1, 2), flux_e=nothing, background_dn=nothing,
                 peak_dn=nothing, pixels=nothing, flags=nothing)


def directions(rng, n, field=0.2):
    v = np.concatenate([rng.uniform(-field, field, (n, 2)), np.ones((n, 1))], 1)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize("dimensions", [1, 3, 5])
def test_codes_are_found_as_by_comparing_all(dimensions):
    rng = np.random.default_rng(dimensions)
    codes = rng.uniform(-0.3, 0.7, (5000, dimensions))
    rows = rng.integers(0, 9000, (5000, 3))
    table = CodeTable.of(codes, rows, np.full(dimensions, 0.05))
    wanted = codes[rng.choice(5000, 60)] + rng.normal(0, 0.02, (60, dimensions))
    tolerance = rng.uniform(0.001, 0.08, (60, dimensions))
    found = set(zip(*table.near(wanted, tolerance), strict=True))
    all_pairs = {(g, e) for g in range(60) for e in np.flatnonzero((np.abs(table.codes - wanted[g]) <= tolerance[g]).all(1))}
    assert found == all_pairs and len(all_pairs) > 10
    assert len(found) == len(table.near(wanted, tolerance)[0])  # none twice
    first = np.flatnonzero((codes.astype(np.float32) == table.codes[7]).all(1))[0]
    assert (table.rows[7] == rows[first]).all()


def test_the_nearest_star_is_that_of_comparing_all(sky):
    rng = np.random.default_rng(1)
    at = np.concatenate([rng.normal(0, 1, (300, 3)), np.eye(3), -np.eye(3)])
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    for radius, limit in ((0.02, 14000), (0.06, 3000), (0.002, 14000)):
        apart = np.linalg.norm(sky.directions[:limit] - at[:, None], axis=2)
        expected = np.where(apart.min(1) < radius, apart.argmin(1), -1)
        assert [kernels.star_near(sky.grid, *v, radius, limit) for v in at] == expected.tolist()
    assert (kernels.stars_near(sky.grid, at, 0.03) >= 0).any()


def test_brightest_in_a_cone(sky):
    centre = np.array([0.6, 0.0, 0.8])
    expected = np.flatnonzero(sky.directions @ centre > np.cos(0.1))[:30]
    np.testing.assert_array_equal(kernels.brightest_within(sky.directions, centre, np.cos(0.1), 30), expected)


def test_odds_are_the_binomial_tail_and_poissons_where_chances_differ():
    for n, p, least in ((10, 0.3, 4), (40, 0.01, 3), (5, 0.5, 5), (5, 0.5, 0)):
        assert kernels.tail(np.full(n, p), least) == pytest.approx(binom.sf(least - 1, n, p), rel=1e-12)
    chances = np.array([0.1, 0.5, 0.02, 0.9, 0.3, 0.25])
    by_hand = sum(np.prod(np.where(hit, chances, 1 - chances)) for hit in itertools.product((True, False), repeat=6)
                  if sum(hit) >= 3)
    assert kernels.tail(chances, 3) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize("model", DISTORTION_NAMES)
@pytest.mark.parametrize("mirrored", [False, True])
def test_directions_and_their_errors_are_those_of_the_projection(model, mirrored):
    rng = np.random.default_rng(2)
    lens = lens_of(model, mirrored=mirrored)
    spots = spots_of(rng.uniform(0, np.subtract(SIZE, 1), (200, 2)), rng)
    view = KnownLens(lens).view(spots)
    v, by_xy = projection.unproject_with_jacobian(lens, spots.xy_px)
    np.testing.assert_allclose(view.directions, v, atol=1e-12)
    covariance = np.eye(2) * np.trace(spots.covariance_px2, axis1=1, axis2=2)[:, None, None] / 2
    random = np.trace(by_xy @ covariance @ np.swapaxes(by_xy, 1, 2), axis1=1, axis2=2) / 2
    assert (view.sigma_rad**2 > 0.95 * random).all()  # the lens's own error is added
    exact = KnownLens(lens_of(model, mirrored=mirrored, covariance=np.zeros_like(lens.covariance))).view(spots).sigma_rad
    model_sd = 0.03**2 * (by_xy**2).sum((1, 2)) / 2
    np.testing.assert_allclose(exact**2, random + model_sd, rtol=0.03)  # between the nodes of the grid


def test_rotation_of_few_pairs_is_scipys():
    rng = np.random.default_rng(3)
    for _ in range(50):
        camera, truth = directions(rng, 4), Rotation.random(random_state=rng).as_matrix()
        noisy = camera + rng.normal(0, 1e-4, camera.shape)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        weight, matrix = rng.uniform(1, 3, 4), np.empty((3, 3))
        stars = camera @ truth
        assert geometry.triad(noisy[0], noisy[1], stars[0], stars[1], matrix)
        for _ in range(3):
            covariance = geometry.fit_rotation(noisy, stars, weight, matrix)
        np.testing.assert_allclose(matrix, Rotation.align_vectors(noisy, stars, weights=weight)[0].as_matrix(), atol=1e-8)
        information = sum(w * (np.eye(3) - np.outer(p, p)) for w, p in zip(weight, stars @ matrix.T, strict=True))
        np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-2)
        drawn = np.cross(rng.multivariate_normal(np.zeros(3), covariance, 4000), camera[0])
        assert geometry.turn_variance(covariance, camera[0]) == pytest.approx((drawn**2).sum(1).mean() / 2, rel=0.1)
    assert not geometry.triad(noisy[0], noisy[0], stars[0], stars[1], matrix)


def test_a_triangle_asks_for_its_sides_in_every_order_that_noise_allows():
    rng = np.random.default_rng(4)
    spots, sigma = directions(rng, 3), np.full(3, 1e-6)
    codes, tolerance, corners = identify.triangle_questions(spots, sigma, 1e-4, np.array([[0, 1, 2]]))
    angles = {k: np.arccos(spots[i] @ spots[j]) for i, j, k in ((1, 2, 0), (2, 0, 1), (0, 1, 2))}
    order = sorted(angles, key=angles.get)
    assert corners.tolist() == [order]
    np.testing.assert_allclose(codes[0], [angles[k] for k in order], rtol=1e-6)
    np.testing.assert_allclose(tolerance[0], 4 * np.sqrt(2) * 1e-6 + 1e-4 * codes[0], rtol=1e-9)
    assert len(identify.triangle_questions(spots, np.full(3, 0.1), 1e-4, np.array([[0, 1, 2]]))[0]) == 6


def test_the_best_of_24_orders_of_four_stars(sky):
    rng = np.random.default_rng(5)
    from calibench.stars.identify._patterns import PERMUTATIONS, PERMUTED_SIDES, SIDES, side_lengths
    for _ in range(20):
        rows = rng.choice(500, 4, replace=False).astype(np.int32)
        shuffled = rng.permutation(rows)
        lengths = side_lengths(sky.directions[rows])[None]
        fits, stars = identify.ordered_quads(lengths * 1.1, np.array([1.2]), shuffled[None], sky.directions, PERMUTATIONS,
                                             PERMUTED_SIDES, SIDES)
        assert fits[0] and (stars[0] == rows).all()
        assert not identify.ordered_quads(lengths * 1.3, np.array([1.2]), shuffled[None], sky.directions, PERMUTATIONS,
                                          PERMUTED_SIDES, SIDES)[0][0]


@pytest.mark.parametrize("mirrored", [False, True])
def test_lens_and_attitude_are_fitted_together(mirrored):
    rng = np.random.default_rng(6)
    truth = lens_of("brown4", fx_px=1000.0, fy_px=1000.0, cx_px=375.5, cy_px=239.5, distortion=[-0.1, 0.03, 0, 0],
                    mirrored=mirrored)
    stars, attitude = directions(rng, 40, 0.2), Rotation.random(random_state=rng)
    xy = projection.project(truth, stars) - (375.5, 239.5)
    lens, matrix = np.array([980.0, 0, 0]), (Rotation.from_rotvec([2e-3, -1e-3, 3e-3]) * attitude).as_matrix()
    off = guess.fit_lens(xy, np.full(40, 0.01), stars @ attitude.as_matrix(), lens, matrix, mirrored)
    assert off.max() < 3e-3  # the terms' prior draws a little
    np.testing.assert_allclose(lens, (1000, -0.1, 0.03), atol=0.012)
    np.testing.assert_allclose(matrix, attitude.as_matrix(), atol=1e-6)


def test_scale_and_handedness_of_a_hypothesis(sky):
    rng = np.random.default_rng(7)
    centre = np.array([0.48, 0.6, 0.64])
    rows = kernels.brightest_within(sky.directions, centre, np.cos(0.12), 16)
    turn = Rotation.align_vectors([[0, 0, 1.0]], [centre])[0]
    seen = turn.apply(sky.directions[rows])
    for scale, mirrored in ((1.0, False), (1.05, True)):
        spots = np.empty_like(seen)
        for i, v in enumerate(seen):
            guess.stretched(v, 1 / scale, mirrored, spots[i])
        spots = spots @ Rotation.from_rotvec([0, 0, rng.uniform(0, 6)]).as_matrix().T
        field = KnownLens(lens_of("pinhole", fx_px=4000.0, fy_px=4000.0)).view(spots_of(np.zeros((1, 2)), rng)).field
        proposal = np.arange(4)[None]
        votes, matrices, scales, flips, fitted = guess.fit_and_vote(
            sky.grid, field._replace(slack=0.1, half_diagonal=0.12), spots, np.full(16, 1e-5), 1e-3, proposal,
            rows[proposal].astype(np.int32))
        assert fitted == 1 and votes[0] == 10  # of the 14 brightest, without the four themselves
        assert scales[0] == pytest.approx(scale, rel=5e-3) and flips[0] == mirrored
        assert np.linalg.det(matrices[0]) == pytest.approx(1)


def test_a_definite_system_and_one_that_is_not():
    rng = np.random.default_rng(8)
    root, x = rng.normal(0, 1, (6, 6)), rng.normal(0, 1, 6)
    matrix = root @ root.T
    right = matrix @ x
    assert geometry.solve_definite(matrix.copy(), right)
    np.testing.assert_allclose(right, x, rtol=1e-8)
    assert not geometry.solve_definite(-matrix, right)
    factor, inverse = matrix.copy(), np.linalg.inv(matrix)
    assert geometry.factor_definite(factor)
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(matrix), rtol=1e-10)
    xx, yy, xy = geometry.inverse_of_first_two(factor, np.empty(6))
    np.testing.assert_allclose((xx, yy, xy), (inverse[0, 0], inverse[1, 1], inverse[0, 1]), rtol=1e-8)
