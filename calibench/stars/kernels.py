"""Compiled loops of identification: the search among codes, stars near a direction, hypotheses fitted and verified.

Types of the records that they take: CodeTable (code_table.py), StarGrid (sky_catalogue.py), Field (view.py).
"""

from __future__ import annotations

import numpy as np

from ..geometry.kernels import fit_rotation, triad, turn_variance, turned
from ..kernels import compiled

HASH_PRIME = 1_000_003
TOLERANCE_SIGMA = 4.0
VERIFY_SPOTS = 60  # the brightest, on which a hypothesis is judged
SUPPORT_SPOTS = 14  # through an unknown lens, the brightest, which are asked first whether they too stand on a star
LEAST_SUPPORT = 2
SUPPORT_STARS = 60  # in a field, among which they are sought
STARS_PER_SPOT = 1.5
FEWEST_STARS = 25
SURPRISE_SIGMA = 3.0  # by which chi^2 has to exceed its expectation before it widens a covariance
NEARBY = 0.2  # of the half diagonal: what counts as the neighbourhood of a spot where stars may flock


@compiled
def bucket_of(codes, cell, buckets):
    """Bucket (Q,) of each code (Q, d): its cell's indices mixed into one number. buckets: a power of two."""
    count, dimensions = codes.shape
    out = np.empty(count, np.int64)
    for q in range(count):
        mixed = 0
        for d in range(dimensions):
            mixed = mixed * HASH_PRIME + int(np.floor(codes[q, d] / cell[d]))
        mixed ^= mixed >> 17
        out[q] = mixed & (buckets - 1)
    return out


@compiled
def codes_near(table, codes, tolerance):
    """Entries of a CodeTable within tolerance (G, d) of codes (G, d): owner (F,), entry (F,)."""
    questions, dimensions = codes.shape
    buckets = len(table.start) - 1
    owner, entry = np.empty(256, np.int64), np.empty(256, np.int64)
    found = 0
    low, high, at = np.empty(dimensions, np.int64), np.empty(dimensions, np.int64), np.empty(dimensions, np.int64)
    for g in range(questions):
        for d in range(dimensions):
            low[d] = int(np.floor((codes[g, d] - tolerance[g, d]) / table.cell[d]))
            high[d] = int(np.floor((codes[g, d] + tolerance[g, d]) / table.cell[d]))
            at[d] = low[d]
        while True:
            mixed = 0
            for d in range(dimensions):
                mixed = mixed * HASH_PRIME + at[d]
            mixed ^= mixed >> 17
            bucket = mixed & (buckets - 1)
            for e in range(table.start[bucket], table.start[bucket + 1]):
                fits = True
                for d in range(dimensions):
                    value = table.codes[e, d]
                    # buckets are shared between cells: only this cell's entries count, or one would be found twice
                    if int(np.floor(value / table.cell[d])) != at[d] or abs(value - codes[g, d]) > tolerance[g, d]:
                        fits = False
                        break
                if fits:
                    if found == len(owner):
                        owner, entry = np.concatenate((owner, owner)), np.concatenate((entry, entry))
                    owner[found], entry[found] = g, e
                    found += 1
            d = dimensions - 1
            while d >= 0:
                at[d] += 1
                if at[d] <= high[d]:
                    break
                at[d] = low[d]
                d -= 1
            if d < 0:
                break
    return owner[:found].copy(), entry[:found].copy()


@compiled
def star_near(grid, x, y, z, radius, limit):
    """The nearest star (its row, -1 for none) within `radius` (chord) of a direction, among the brightest `limit` rows."""
    half = grid.cells / 2
    last = grid.cells - 1
    best, nearest = radius * radius, -1
    for i in range(max(int((x - radius + 1) * half), 0), min(int((x + radius + 1) * half), last) + 1):
        for j in range(max(int((y - radius + 1) * half), 0), min(int((y + radius + 1) * half), last) + 1):
            for k in range(max(int((z - radius + 1) * half), 0), min(int((z + radius + 1) * half), last) + 1):
                cell = (i * grid.cells + j) * grid.cells + k
                for e in range(grid.start[cell], grid.start[cell + 1]):
                    row = grid.rows[e]
                    if row >= limit:  # a cell's rows ascend: the rest is fainter
                        break
                    dx, dy, dz = grid.directions[row, 0] - x, grid.directions[row, 1] - y, grid.directions[row, 2] - z
                    off = dx * dx + dy * dy + dz * dz
                    if off < best:
                        best, nearest = off, row
    return nearest


@compiled
def stars_near(grid, directions, radius):
    """Row (N,) of the star nearest to each direction (N, 3) within radius (chord), -1 where there is none."""
    out = np.empty(len(directions), np.int64)
    for i in range(len(directions)):
        out[i] = star_near(grid, directions[i, 0], directions[i, 1], directions[i, 2], radius, len(grid.directions))
    return out


@compiled
def tail(chances, least):
    """P(at least `least` successes) of independent trials with these chances (N,): Poisson's binomial law, summed exactly."""
    if least <= 0:
        return 1.0
    mass = np.zeros(least)  # of 0 .. least - 1 successes so far
    mass[0] = 1.0
    reached = 0.0
    for p in chances:
        reached += mass[least - 1] * p
        for s in range(least - 1, 0, -1):
            mass[s] = mass[s] * (1 - p) + mass[s - 1] * p
        mass[0] *= 1 - p
    return min(reached, 1.0)


@compiled
def widening(chi2, freedom):
    """What a covariance is to be multiplied by: chi^2 over its degrees of freedom where that is a surprise, else 1.

    A scale taken from every frame would be too large on average.
    """
    return chi2 / freedom if chi2 > freedom + SURPRISE_SIGMA * np.sqrt(2.0 * freedom) else 1.0


@compiled
def brightest_within(directions, centre, cos_radius, most):
    """Rows (K,) of the brightest stars, at most `most`, within a cone about centre (3,)."""
    rows = np.empty(most, np.int64)
    found = 0
    for s in range(len(directions)):
        if directions[s, 0] * centre[0] + directions[s, 1] * centre[1] + directions[s, 2] * centre[2] > cos_radius:
            rows[found] = s
            found += 1
            if found == most:
                break
    return rows[:found]


@compiled
def expected_near(stars, cone, at, spread, radius):
    """Stars expected by chance within radius (n,) of directions at (n, 3): at the cone's density, or at that nearby if higher.

    stars (K, 3): those of a cone of solid angle `cone`. spread: angle of what counts as nearby. Stars flock, and so do spots
    (a cluster, a tree's edge): with an even density a coincidence of two flocks would look like a proof.
    """
    out = np.empty(len(at))
    even = len(stars) / cone
    cos_spread = np.cos(spread)
    nearby = 2 * np.pi * (1 - cos_spread)
    for i in range(len(at)):
        count = 0
        for star in stars:
            if star[0] * at[i, 0] + star[1] * at[i, 1] + star[2] * at[i, 2] > cos_spread:
                count += 1
        out[i] = min(max(even, count / nearby) * np.pi * radius[i] ** 2, 1.0)
    return out


@compiled
def one_spot_a_star(star, off):
    """Where several spots claim one star (rows (n,), -1: none), only the nearest keeps it; changed in place."""
    for i in range(len(star)):
        for j in range(i):
            if star[i] >= 0 and star[i] == star[j]:
                if off[i] < off[j]:
                    star[j] = -1
                else:
                    star[i] = -1


@compiled
def match_spots(grid, spots, matrix, radius, limit):
    """For each spot (n, 3) the star (row, or -1) nearest to where `matrix` puts it, within radius (n,), each star once.

    Returns star (n,), off (n,) chord.
    """
    star, off, there = np.empty(len(spots), np.int64), np.zeros(len(spots)), np.empty(3)
    back = matrix.T.copy()
    for i in range(len(spots)):
        turned(back, spots[i], there)
        star[i] = star_near(grid, there[0], there[1], there[2], radius[i], limit)
        if star[i] >= 0:
            off[i] = np.sqrt(((grid.directions[star[i]] - there) ** 2).sum())
    one_spot_a_star(star, off)
    return star, off


@compiled
def stars_for(spots):
    """How many catalogue stars a frame with so many spots is compared with."""
    return max(FEWEST_STARS, int(STARS_PER_SPOT * spots))


@compiled
def stars_voting(stars, field):
    """How many of the brightest rows of the catalogue make SUPPORT_STARS in such a field."""
    solid_angle = 2 * np.pi * (1 - np.cos(field.half_diagonal)) * field.filling
    return min(stars, int(SUPPORT_STARS * 4 * np.pi / solid_angle))


@compiled
def fit_group(spots, sigma, directions, spot_rows, star_rows, slack, matrix):
    """Rotation of one correspondence (k,), into matrix; (does it fit, covariance, middle (3,) of the spots)."""
    corners = len(spot_rows)
    camera, sky, weight, middle = np.empty((corners, 3)), np.empty((corners, 3)), np.empty(corners), np.zeros(3)
    for c in range(corners):
        camera[c], sky[c] = spots[spot_rows[c]], directions[star_rows[c]]
        weight[c] = 1 / sigma[spot_rows[c]] ** 2
        middle += camera[c] / corners
    far, widest, extent = 1, 0.0, 0.0
    for c in range(corners):
        apart = ((camera[c] - camera[0]) ** 2).sum()
        if apart > widest:
            widest, far = apart, c
        extent = max(extent, np.sqrt(((camera[c] - middle) ** 2).sum()))
    if not triad(camera[0], camera[far], sky[0], sky[far], matrix):
        return False, np.zeros((3, 3)), middle
    fit_rotation(camera, sky, weight, matrix)
    covariance = fit_rotation(camera, sky, weight, matrix)
    p = np.empty(3)
    for c in range(corners):
        turned(matrix, sky[c], p)
        limit = TOLERANCE_SIGMA * sigma[spot_rows[c]] + slack * extent
        if ((camera[c] - p) ** 2).sum() > limit * limit:
            return False, covariance, middle
    return True, covariance, middle


@compiled
def judge_known(grid, field, spots, sigma, spot_rows, star_rows, tried, accept):
    """Fit each correspondence (B, k) through a known lens and verify it against all stars in view, until one is believed.

    spots (N, 3) directions, brightest first; sigma (N,) rad. tried: hypotheses fitted before; accept: the false-match
    probability to be beaten.
    Returns (index of the best or -1, its probability, hypotheses fitted so far, its matrix, its covariance).
    """
    judged = min(VERIFY_SPOTS, len(spots))
    matrix, best_matrix, best_covariance = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    there, radius, own = np.empty(3), np.empty(judged), np.zeros(judged, np.bool_)
    voting = stars_voting(len(grid.directions), field)
    best, chosen = 1.0, -1
    for b in range(len(spot_rows)):
        fits, covariance, middle = fit_group(spots, sigma, grid.directions, spot_rows[b], star_rows[b], field.slack, matrix)
        if not fits:
            continue
        tried += 1
        own[:] = False
        for row in spot_rows[b]:
            if row < judged:
                own[row] = True
        votes, asked = 0, 0
        back = matrix.T.copy()
        for i in range(judged):
            away = np.sqrt(((spots[i] - middle) ** 2).sum())
            variance = sigma[i] ** 2 + turn_variance(covariance, spots[i])
            radius[i] = TOLERANCE_SIGMA * np.sqrt(variance) + field.slack * away
            if own[i] or votes == LEAST_SUPPORT:  # the brightest may all be a Moon's glare: go on until some spots agree
                continue
            asked += 1
            turned(back, spots[i], there)
            votes += star_near(grid, there[0], there[1], there[2], radius[i], voting) >= 0
        if votes < min(LEAST_SUPPORT, asked):
            continue
        probability = chance_known(grid, field, spots[:judged], radius, own, matrix)
        # The k-th trial gets the share 1 / (k ln^2 k): however long the search is, the shares sum to about one.
        probability = min(1.0, probability * 2 * tried * (1 + np.log(tried)) ** 2)
        if probability < best:
            best, chosen = probability, b
            best_matrix[:] = matrix
            best_covariance[:] = covariance
            if best < accept:
                break
    return chosen, best, tried, best_matrix, best_covariance


@compiled
def chance_known(grid, field, spots, radius, own, matrix):
    """Probability that so many spots beyond the hypothesis's own (bool (n,)) stand within radius (n,) of a star by chance."""
    centre = np.empty(3)
    turned(matrix.T.copy(), field.centre, centre)
    most = int(stars_for(len(spots)) / field.filling)
    rows = brightest_within(grid.directions, centre, np.cos(field.half_diagonal), most)
    if len(rows) == 0:
        return 1.0
    star, _ = match_spots(grid, spots, matrix, radius, rows[-1] + 1)
    camera, others, agreeing = np.empty((len(rows), 3)), 0, 0
    for s in range(len(rows)):
        turned(matrix, grid.directions[rows[s]], camera[s])
    for i in range(len(spots)):
        others += not own[i]
        agreeing += not own[i] and star[i] >= 0
    cone = 2 * np.pi * (1 - np.cos(field.half_diagonal))
    chances = expected_near(camera, cone, spots, NEARBY * field.half_diagonal, radius)
    return tail(chances[~own], agreeing)


@compiled
def final_match(grid, field, spots, sigma, matrix, covariance):
    """All spots (N, 3) that a believed attitude puts on a star, once more after the attitude was fitted to them.

    Returns (spot rows (M,), star rows (M,), matrix).
    """
    centre, matrix, weight, radius = np.empty(3), matrix.copy(), 1 / sigma**2, np.empty(len(sigma))
    turned(matrix.T.copy(), field.centre, centre)
    rows = brightest_within(grid.directions, centre, np.cos(field.half_diagonal), int(stars_for(len(spots)) / field.filling))
    least = 0.0
    for _ in range(2):
        for i in range(len(spots)):
            radius[i] = max(TOLERANCE_SIGMA * np.sqrt(sigma[i] ** 2 + turn_variance(covariance, spots[i])), least)
        star, off = match_spots(grid, spots, matrix, radius, rows[-1] + 1)
        spot = np.flatnonzero(star >= 0)
        sky = np.empty((len(spot), 3))
        for m in range(len(spot)):
            sky[m] = grid.directions[star[spot[m]]]
        covariance = fit_rotation(spots[spot], sky, weight[spot], matrix)
        # Where stars miss by more than their errors (a lens a little out of focus) the circle follows what is seen.
        least = min(5 * np.median(off[spot]) / 1.177, field.widest)
    return spot, star[spot], matrix
