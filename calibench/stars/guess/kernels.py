"""Compiled loops for an unknown lens: hypotheses with scale and handedness, voted on by bright spots; the match that grows
from one, with focal length, k1 and k2 fitted as it grows."""

from __future__ import annotations

import numpy as np

from ...geometry.kernels import fit_rotation, solve_definite, triad, turn_by, turned
from ...kernels import compiled
from ..kernels import (
    LEAST_SUPPORT,
    NEARBY,
    SUPPORT_SPOTS,
    TOLERANCE_SIGMA,
    VERIFY_SPOTS,
    brightest_within,
    expected_near,
    one_spot_a_star,
    star_near,
    stars_for,
    stars_voting,
    tail,
)

FIT_STEPS, ROUNDS = 6, 5
HUBER_SIGMA = 2.5
K1_FROM, K2_FROM = 8, 16  # matches needed before a distortion term is fitted
K_PRIOR_SD = 0.5  # keeps terms that a narrow field cannot see near zero
FIRST_RADIUS = 0.010  # of the half diagonal: how far an unfitted lens may throw a star at first
SMALLEST_RADIUS_PX = 1.0


@compiled
def stretched(v, scale, mirrored, out):
    """Direction v (3,) with its tangent stretched by `scale`, as another focal length would, x flipped where mirrored."""
    x, y = v[0] / v[2] * scale, v[1] / v[2] * scale
    length = np.sqrt(x * x + y * y + 1)
    out[0], out[1], out[2] = (-x if mirrored else x) / length, y / length, 1 / length


@compiled
def same_hand(a, b):
    """Whether two figures of directions (k, 3) turn the same way: their triangles' volumes, multiplied and summed."""
    total = 0.0
    for i in range(len(a)):
        for j in range(i):
            for k in range(j):
                of_a = ((a[i, 1] * a[j, 2] - a[i, 2] * a[j, 1]) * a[k, 0] + (a[i, 2] * a[j, 0] - a[i, 0] * a[j, 2]) * a[k, 1]
                        + (a[i, 0] * a[j, 1] - a[i, 1] * a[j, 0]) * a[k, 2])
                of_b = ((b[i, 1] * b[j, 2] - b[i, 2] * b[j, 1]) * b[k, 0] + (b[i, 2] * b[j, 0] - b[i, 0] * b[j, 2]) * b[k, 1]
                        + (b[i, 0] * b[j, 1] - b[i, 1] * b[j, 0]) * b[k, 2])
                total += of_a * of_b
    return total >= 0


@compiled
def spread(v):
    """Sum of the distances of directions (k, 3) from their mean."""
    middle, total = np.zeros(3), 0.0
    for i in range(len(v)):
        middle += v[i] / len(v)
    for i in range(len(v)):
        total += np.sqrt(((v[i] - middle) ** 2).sum())
    return total


@compiled
def fit_and_vote(grid, field, spots, sigma, bend, spot_rows, star_rows):
    """Attitude, scale and handedness of each correspondence (B, k), k > 2, and how many other bright spots stand on a star.

    spots (N, 3) directions under the guess, sigma (N,); bend: how far, of an angle, the unknown distortion may move a spot.
    Returns votes (B,), -1 where a hypothesis does not fit or has too few; matrices (B, 3, 3); scale (B,); mirrored (B,); how
    many fitted.
    """
    count, corners = spot_rows.shape
    votes, matrices = np.full(count, -1), np.empty((count, 3, 3))
    scales, mirrored = np.empty(count), np.empty(count, np.bool_)
    camera, sky, turned_camera = np.empty((corners, 3)), np.empty((corners, 3)), np.empty((corners, 3))
    weight = np.empty(corners)
    v, there, middle = np.empty(3), np.empty(3), np.empty(3)
    voting, fitted, n = stars_voting(len(grid.directions), field), 0, min(SUPPORT_SPOTS, len(spots))
    for b in range(count):
        noise = 0.0
        for c in range(corners):
            camera[c], sky[c] = spots[spot_rows[b, c]], grid.directions[star_rows[b, c]]
            noise += sigma[spot_rows[b, c]] ** 2
            weight[c] = 1 / sigma[spot_rows[b, c]] ** 2
        size = spread(camera)
        scale = spread(sky) / max(size, 1e-12)
        most = (1 + field.slack) * (1 + 3 * np.sqrt(noise) / max(size, 1e-12))
        if not 1 / most < scale < most:
            continue
        flip = not same_hand(camera, sky)
        middle[:] = 0.0
        for c in range(corners):
            stretched(camera[c], scale, flip, turned_camera[c])
            middle += turned_camera[c] / corners
        extent = 0.0
        for c in range(corners):
            extent = max(extent, np.sqrt(((turned_camera[c] - middle) ** 2).sum()))
        matrix = matrices[b]
        if not triad(turned_camera[0], turned_camera[1], sky[0], sky[1], matrix):
            continue
        for _ in range(3):
            fit_rotation(turned_camera, sky, weight, matrix)
        fits = True
        for c in range(corners):
            turned(matrix, sky[c], there)
            limit = TOLERANCE_SIGMA * sigma[spot_rows[b, c]] + bend * extent
            if ((turned_camera[c] - there) ** 2).sum() > limit * limit:
                fits = False
                break
        if not fits:
            continue
        fitted += 1
        said, others = 0, 0
        back = matrix.T.copy()
        for i in range(n):
            if (spot_rows[b] == i).any():  # the group's own corners do not vote
                continue
            others += 1
            stretched(spots[i], scale, flip, v)
            turned(back, v, there)
            radius = TOLERANCE_SIGMA * sigma[i] + bend * field.half_diagonal * (1 + field.slack)
            said += star_near(grid, there[0], there[1], there[2], radius, voting) >= 0
        if said >= min(LEAST_SUPPORT, others):
            votes[b], scales[b], mirrored[b] = said, scale, flip
    return votes, matrices, scales, mirrored, fitted


@compiled
def project_brown(lens, matrix, star, mirrored, out):
    """Pixel, from the image's centre, of a star (3,) through lens (3,) = f, k1, k2, and its derivatives, out (2, 7): place, by
    a turn (3) in camera axes, by f, k1, k2. False where it is not before the camera or the lens folds."""
    p = np.empty(3)
    turned(matrix, star, p)
    if p[2] < 0.05:
        return False
    side = -1.0 if mirrored else 1.0
    x, y, z = side * p[0] / p[2], p[1] / p[2], p[2]
    u = x * x + y * y
    g, dg = 1 + u * (lens[1] + u * lens[2]), 2 * (lens[1] + 2 * u * lens[2])
    if g + u * dg <= 0:
        return False
    f = lens[0]
    xx, xy, yy = f * (g + x * x * dg), f * x * y * dg, f * (g + y * y * dg)
    # a turn d moves p by d x p
    for axis in range(3):
        move = np.zeros(3)
        move[(axis + 1) % 3], move[(axis + 2) % 3] = -p[(axis + 2) % 3], p[(axis + 1) % 3]
        dx, dy = (side * move[0] - x * move[2]) / z, (move[1] - y * move[2]) / z
        out[0, 1 + axis], out[1, 1 + axis] = xx * dx + xy * dy, xy * dx + yy * dy
    out[0, 0], out[1, 0] = f * x * g, f * y * g
    out[0, 4], out[1, 4] = x * g, y * g
    out[0, 5], out[1, 5] = f * x * u, f * y * u
    out[0, 6], out[1, 6] = f * x * u * u, f * y * u * u
    return True


@compiled
def fit_lens(xy, variance, stars, lens, matrix, mirrored):
    """Gauss-Newton for attitude, focal length, and k1, k2 as the matches allow, in place.

    Returns off (M,) px.

    xy (M, 2) from the image's centre; variance (M,) px^2 of one axis. Large residuals are given less weight (Huber).
    """
    m = len(xy)
    free = 4 + (m >= K1_FROM) + (m >= K2_FROM)
    row, off = np.empty((2, 7)), np.full(m, np.inf)
    for turn in range(FIT_STEPS + 1):
        normal, gradient = np.zeros((free, free)), np.zeros(free)
        for k in range(4, free):
            normal[k, k] = 1 / K_PRIOR_SD**2
            gradient[k] = -lens[k - 3] / K_PRIOR_SD**2
        for i in range(m):
            off[i] = np.inf
            if not project_brown(lens, matrix, stars[i], mirrored, row):
                continue
            ex, ey = xy[i, 0] - row[0, 0], xy[i, 1] - row[1, 0]
            off[i] = np.sqrt(ex * ex + ey * ey)
            w = min(1.0, HUBER_SIGMA * np.sqrt(variance[i]) / max(off[i], 1e-9)) / variance[i]
            for a in range(free):
                gradient[a] += w * (row[0, 1 + a] * ex + row[1, 1 + a] * ey)
                for b in range(a + 1):
                    normal[a, b] += w * (row[0, 1 + a] * row[0, 1 + b] + row[1, 1 + a] * row[1, 1 + b])
        if turn == FIT_STEPS or not solve_definite(normal, gradient):
            break
        turn_by(gradient[:3], matrix)
        lens[0] = max(lens[0] + gradient[3], 0.1 * lens[0])
        for k in range(4, free):
            lens[k - 3] += gradient[k]
    return off


@compiled
def stars_on_frame(grid, lens, matrix, mirrored, cos_radius, half_size, most):
    """The brightest stars on the frame, at most `most`: rows (K,) and places (K, 2) px from the image's centre."""
    rows, xy, row = np.empty(most, np.int64), np.empty((most, 2)), np.empty((2, 7))
    found = 0
    for s in brightest_within(grid.directions, matrix[2].copy(), cos_radius, len(grid.directions)):
        if not project_brown(lens, matrix, grid.directions[s], mirrored, row):
            continue
        if abs(row[0, 0]) < half_size[0] and abs(row[1, 0]) < half_size[1]:
            rows[found], xy[found] = s, row[:, 0]
            found += 1
            if found == most:
                break
    return rows[:found], xy[:found]


@compiled
def pair_up(spots_xy, stars_xy, radius):
    """For each spot (n, 2) the nearest star within radius (index, or -1), each star once."""
    star, off = np.full(len(spots_xy), -1), np.full(len(spots_xy), radius)
    for i in range(len(spots_xy)):
        for s in range(len(stars_xy)):
            dx, dy = spots_xy[i, 0] - stars_xy[s, 0], spots_xy[i, 1] - stars_xy[s, 1]
            if abs(dx) < off[i] and dx * dx + dy * dy < off[i] ** 2:
                off[i], star[i] = np.sqrt(dx * dx + dy * dy), s
    one_spot_a_star(star, off)
    return star


@compiled
def grow(grid, field, xy, variance, spots, lens, matrix, mirrored, half_size, corners, tried):
    """The match that grows from one hypothesis, lens fitted on the way, and its false-match probability.

    xy (N, 2) spots in px from the image's centre, variance (N,) px^2 of one axis (centroid and model), spots (N, 3) their
    directions under the hypothesis; lens (3,) = f, k1, k2 and matrix (3, 3) are changed in place; half_size (2,): w/2, h/2.
    Returns (probability, spot rows (M,), star rows (M,)).
    """
    judged = min(VERIFY_SPOTS, len(xy))
    n = judged
    half_px = np.sqrt(half_size[0] ** 2 + half_size[1] ** 2)
    radius = 4 * np.sqrt(np.median(variance[:judged])) + FIRST_RADIUS * half_px
    cos_radius = np.cos(min(1.1 * field.half_diagonal * (1 + field.slack), 1.4))
    nothing = np.zeros(0, np.int64)
    for turn in range(ROUNDS):
        if turn == ROUNDS - 1:  # the last round takes every spot and as many stars
            n = len(xy)
        rows, places = stars_on_frame(grid, lens, matrix, mirrored, cos_radius, half_size, stars_for(n))
        star = pair_up(xy[:n], places, radius)
        spot = np.flatnonzero(star >= 0)
        if len(spot) < corners:
            return 1.0, nothing, nothing
        sky = np.empty((len(spot), 3))
        for m in range(len(spot)):
            sky[m] = grid.directions[rows[star[spot[m]]]]
        off = fit_lens(xy[spot], variance[spot], sky, lens, matrix, mirrored)
        before = radius
        radius = max(SMALLEST_RADIUS_PX, min(radius, 5 * 1.48 * np.median(off) / 1.25))
    stars = min(len(rows), stars_for(judged))
    kept = off < radius
    agreeing = 0
    for m in range(len(spot)):
        agreeing += kept[m] and spot[m] < judged and star[spot[m]] < stars
    others = judged - corners
    if agreeing <= corners:
        return 1.0, spot[kept], rows[star[spot[kept]]]
    # Half of the frame's fit is hindsight: chance is counted in a circle no smaller than twice the last.
    counted = max(radius, min(before, 2 * radius))
    camera, where = np.empty((stars, 3)), np.empty((judged, 3))
    for s in range(stars):
        turned(matrix, grid.directions[rows[s]], camera[s])
    where[:] = spots[:judged]
    frame = 4 * half_size[0] * half_size[1] / lens[0] ** 2
    expected = expected_near(camera, frame, where, NEARBY * field.half_diagonal, np.full(judged, counted / lens[0]))
    expected[::-1].sort()
    probability = min(1.0, tail(expected[:others], agreeing - corners) * max(tried, 1) * 2 * (1 + np.log(max(tried, 1))) ** 2)
    return probability, spot[kept], rows[star[spot[kept]]]
