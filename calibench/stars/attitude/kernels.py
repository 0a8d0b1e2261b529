"""Compiled: an identified frame against a rotation (directions through the lens with all derivatives, residuals, covariance),
and what QUEST and its kin do with the profile matrix B."""

from __future__ import annotations

import math

import numpy as np

from ...geometry.kernels import bend_rational, solve3
from ...kernels import compiled

NEAR_AXIS = 1e-8
NEWTON_STEPS, ROOT_SETTLED = 30, 1e-15
FLIPS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # diagonals: no turn, and half turns about x, y, z


@compiled
def _rational_terms(k, x, y, slopes):
    """Derivatives of (x', y') by the first terms of a rational lens, into slopes (T, 2)."""
    u, count = x * x + y * y, len(slopes)
    d = 1 + u * (k[5] + u * (k[6] + u * k[7]))
    g, power = (1 + u * (k[0] + u * (k[1] + u * k[4]))) / d, u / d
    for up, down in ((0, 5), (1, 6), (4, 7)):
        if up < count:
            slopes[up, 0], slopes[up, 1] = x * power, y * power
        if down < count:
            slopes[down, 0], slopes[down, 1] = -x * power * g, -y * power * g
        power *= u
    if count > 3:
        slopes[2, 0] = slopes[3, 1] = 2 * x * y
        slopes[2, 1], slopes[3, 0] = u + 2 * y * y, u + 2 * x * x
    if count > 8:
        slopes[8:] = 0.0
        slopes[8, 0] = slopes[10, 1] = u
        slopes[9, 0] = slopes[11, 1] = u * u


@compiled
def _fisheye(k, x, y, z, slopes):
    """x', y' of a direction; dx'/dX, dx'/dY, dx'/dZ, dy'/dX, dy'/dY, dy'/dZ; by the first terms into slopes (T, 2)."""
    r = math.sqrt(x * x + y * y)
    t = math.atan2(r, z)
    u = t * t
    h = t * (1 + u * (k[0] + u * (k[1] + u * (k[2] + u * k[3]))))
    slope = 1 + u * (3 * k[0] + u * (5 * k[1] + u * (7 * k[2] + u * 9 * k[3])))
    length2, grow = r * r + z * z, 0.0
    if r < NEAR_AXIS * abs(z):
        scale, cos, sin = 1 / z, x / abs(z), y / abs(z)
    else:
        scale, cos, sin = h / r, x / r, y / r
        grow = (slope * z / length2 - scale) / (r * r)
    by_z, power = -slope * r / length2, t * u
    for i in range(len(slopes)):
        slopes[i, 0], slopes[i, 1] = power * cos, power * sin
        power *= u
    cross = x * y * grow
    return x * scale, y * scale, scale + x * x * grow, cross, by_z * cos, cross, scale + y * y * grow, by_z * sin


@compiled
def project(camera, k, fisheye, fold, terms, v):
    """Directions (N, 3) in camera axes through a lens as `lens_terms` gives it; NaN where nothing is seen.

    terms: how many distortion terms the model has. Returns xy (N, 2) px, d xy / d v (N, 2, 3), and d xy / d parameters
    (N, 2, 5 + terms): fx, fy, cx, cy, the terms, skew.
    """
    count = len(v)
    xy, by_v, by_p = np.full((count, 2), np.nan), np.full((count, 2, 3), np.nan), np.zeros((count, 2, 5 + terms))
    slopes, skew = np.empty((terms, 2)), camera[5]
    for n in range(count):
        x, y, z = camera[4] * v[n, 0], v[n, 1], v[n, 2]
        if fisheye:
            if not math.atan2(math.sqrt(x * x + y * y), z) < fold:
                continue
            xd, yd, xx, xy_, xz, yx, yy, yz = _fisheye(k, x, y, z, slopes)
        else:
            tx, ty = x / z, y / z
            if not (z > 0 and tx * tx + ty * ty < fold * fold):
                continue
            xd, yd, xx, xy_, yx, yy = bend_rational(k, tx, ty)
            xx, xy_, yx, yy = xx / z, xy_ / z, yx / z, yy / z
            xz, yz = -(tx * xx + ty * xy_), -(tx * yx + ty * yy)
            _rational_terms(k, tx, ty, slopes)
        xy[n, 0], xy[n, 1] = camera[0] * xd + skew * yd + camera[2], camera[1] * yd + camera[3]
        by_v[n, 0, 0], by_v[n, 1, 0] = camera[4] * (camera[0] * xx + skew * yx), camera[4] * camera[1] * yx
        by_v[n, 0, 1], by_v[n, 1, 1] = camera[0] * xy_ + skew * yy, camera[1] * yy
        by_v[n, 0, 2], by_v[n, 1, 2] = camera[0] * xz + skew * yz, camera[1] * yz
        by_p[n, 0, 0], by_p[n, 1, 1], by_p[n, 0, 4 + terms] = xd, yd, yd
        by_p[n, 0, 2] = by_p[n, 1, 3] = 1.0
        for i in range(terms):
            by_p[n, 0, 4 + i] = camera[0] * slopes[i, 0] + skew * slopes[i, 1]
            by_p[n, 1, 4 + i] = camera[1] * slopes[i, 1]
    return xy, by_v, by_p


@compiled
def direction_variance(by_v, covariance_px2, model_variance_px2):
    """Variance (N,), rad^2, mean of the two axes, of directions whose pixels go with them by by_v (N, 2, 3) and have covariance
    (N, 2, 2), the lens model's own added."""
    out = np.empty(len(by_v))
    for n in range(len(by_v)):
        aa = ab = bb = 0.0
        for i in range(3):
            aa, bb = aa + by_v[n, 0, i] ** 2, bb + by_v[n, 1, i] ** 2
            ab += by_v[n, 0, i] * by_v[n, 1, i]
        own = covariance_px2[n]
        trace = (own[0, 0] + model_variance_px2) * bb + (own[1, 1] + model_variance_px2) * aa - (own[0, 1] + own[1, 0]) * ab
        out[n] = trace / (aa * bb - ab * ab) / 2
    return out


@compiled
def misses2(residual, covariance_px2, model_variance_px2):
    """Squared Mahalanobis distance (N,) of residuals (N, 2), the lens model's own variance added to the spots' covariance."""
    out = np.empty(len(residual))
    for n in range(len(residual)):
        a, c = covariance_px2[n, 0, 0] + model_variance_px2, covariance_px2[n, 1, 1] + model_variance_px2
        b, x, y = covariance_px2[n, 0, 1], residual[n, 0], residual[n, 1]
        out[n] = (c * x * x - 2 * b * x * y + a * y * y) / (a * c - b * b)
    return out


@compiled
def _turned_by(by_v, u, turn):
    """d xy / d rotation vector (2, 3) = by_v (2, 3) (-[u]x), into turn."""
    for r in range(2):
        for i in range(3):
            turn[r, i] = by_v[r, (i + 2) % 3] * u[(i + 1) % 3] - by_v[r, (i + 1) % 3] * u[(i + 2) % 3]


@compiled
def spread(measured_by_v, weight, covariance_px2, extra_px2, u, by_v, by_p, lens_covariance, residual):
    """Covariance (3, 3), rad^2 in camera axes, of a rotation found with `weight` (N,) on directions measured where the lens
    goes by measured_by_v (N, 2, 3), and the smallest chi^2 that any rotation nearby reaches.

    covariance_px2 (N, 2, 2), extra_px2 added to its diagonal; u (N, 3): the stars in camera axes; by_v (N, 2, 3), by_p
    (N, 2, >= P) there; lens_covariance (P, P): what it lets expect counts in chi^2, not in the covariance.
    """
    known, inner, normal = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    pull, turned, turn, back = np.zeros(3), np.empty((3, 2)), np.empty((2, 3)), np.empty((3, 2))
    own, parameters, chi2 = np.empty((2, 2)), len(lens_covariance), 0.0
    half = np.empty((2, parameters))
    for n in range(len(u)):
        f, v = measured_by_v[n], u[n]
        aa = ab = bb = 0.0
        for i in range(3):
            aa, bb, ab = aa + f[0, i] ** 2, bb + f[1, i] ** 2, ab + f[0, i] * f[1, i]
        determinant = aa * bb - ab * ab
        for i in range(3):  # d direction / d xy: the pseudo-inverse stays in the tangent plane
            back[i, 0], back[i, 1] = (bb * f[0, i] - ab * f[1, i]) / determinant, (aa * f[1, i] - ab * f[0, i]) / determinant
        for r in range(2):
            for i in range(3):
                one, other = (i + 1) % 3, (i + 2) % 3
                turned[i, r] = weight[n] * (v[one] * back[other, r] - v[other] * back[one, r])
        for r in range(2):
            for c in range(2):
                own[r, c] = covariance_px2[n, r, c] + (extra_px2 if r == c else 0.0)
        for i in range(3):
            known[i, i] += weight[n]
            left = turned[i, 0] * own[0, 0] + turned[i, 1] * own[1, 0]
            right = turned[i, 0] * own[0, 1] + turned[i, 1] * own[1, 1]
            for j in range(3):
                known[i, j] -= weight[n] * v[i] * v[j]
                inner[i, j] += left * turned[j, 0] + right * turned[j, 1]
        for r in range(2):
            for p in range(parameters):
                half[r, p] = 0.0
                for q in range(parameters):
                    half[r, p] += by_p[n, r, q] * lens_covariance[q, p]
        for r in range(2):
            for c in range(2):
                for p in range(parameters):
                    own[r, c] += half[r, p] * by_p[n, c, p]
        determinant = own[0, 0] * own[1, 1] - own[0, 1] * own[1, 0]
        wxx, wyy, wxy = own[1, 1] / determinant, own[0, 0] / determinant, -own[0, 1] / determinant
        x, y = residual[n]
        wx, wy = wxx * x + wxy * y, wxy * x + wyy * y
        chi2 += x * wx + y * wy
        _turned_by(by_v[n], v, turn)
        for i in range(3):
            pull[i] += turn[0, i] * wx + turn[1, i] * wy
            gx, gy = wxx * turn[0, i] + wxy * turn[1, i], wxy * turn[0, i] + wyy * turn[1, i]
            for j in range(3):
                normal[i, j] += gx * turn[0, j] + gy * turn[1, j]
    gain, _, _ = solve3(known, pull)
    _, step, _ = solve3(normal, pull)
    for i in range(3):
        chi2 -= pull[i] * step[i]
    covariance = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for p in range(3):
                for q in range(3):
                    covariance[i, j] += gain[i, p] * inner[p, q] * gain[j, q]
    return covariance, chi2


@compiled
def _symmetric(b, flip):
    """Of the columns of B (3, 3) times a flip (3,): sigma; S = B + B' as s11, s22, s33, s12, s13, s23."""
    d1, d2, d3 = b[0, 0] * flip[0], b[1, 1] * flip[1], b[2, 2] * flip[2]
    return (d1 + d2 + d3, 2 * d1, 2 * d2, 2 * d3, b[0, 1] * flip[1] + b[1, 0] * flip[0], b[0, 2] * flip[2] + b[2, 0] * flip[0],
            b[1, 2] * flip[2] + b[2, 1] * flip[1])


@compiled
def _twist(b, flip, s11, s22, s33, s12, s13, s23):
    """z = (B23 - B32, B31 - B13, B12 - B21) of the flipped B, and S z."""
    z1, z2 = b[1, 2] * flip[2] - b[2, 1] * flip[1], b[2, 0] * flip[0] - b[0, 2] * flip[2]
    z3 = b[0, 1] * flip[1] - b[1, 0] * flip[0]
    return (z1, z2, z3, s11 * z1 + s12 * z2 + s13 * z3, s12 * z1 + s22 * z2 + s23 * z3, s13 * z1 + s23 * z2 + s33 * z3)


@compiled
def _minors_and_determinant(s11, s22, s33, s12, s13, s23):
    """tr adj S, safe for a singular S, and det S."""
    minors = s22 * s33 - s23 * s23 + s11 * s33 - s13 * s13 + s11 * s22 - s12 * s12
    return minors, s11 * (s22 * s33 - s23 * s23) - s12 * (s12 * s33 - s23 * s13) + s13 * (s12 * s23 - s22 * s13)


@compiled
def largest_root(b):
    """The largest root of K's characteristic polynomial by Newton, from the sum of the weights (1) downwards.

    psi(l) = l^4 - (a + b) l^2 - c l + (a b + c sigma - d), a = sigma^2 - tr adj S, b = sigma^2 + z.z, c = det S + z.S z,
    d = z.S^2 z. All four roots are real and 1 lies at or above the largest, so the steps go down to it without passing it;
    they end where psi's slope is lost in rounding (few, noisy stars: a nearly double root), and `settled` does the rest.
    """
    sigma, s11, s22, s33, s12, s13, s23 = _symmetric(b, FLIPS[0])
    z1, z2, z3, y1, y2, y3 = _twist(b, FLIPS[0], s11, s22, s33, s12, s13, s23)
    minors, determinant = _minors_and_determinant(s11, s22, s33, s12, s13, s23)
    first, second = sigma * sigma - minors, sigma * sigma + z1 * z1 + z2 * z2 + z3 * z3
    c, d = determinant + z1 * y1 + z2 * y2 + z3 * y3, y1 * y1 + y2 * y2 + y3 * y3
    constant = first * second + c * sigma - d
    l = 1.0
    for _ in range(NEWTON_STEPS):
        square = l * l
        slope = 4 * l * square - 2 * (first + second) * l - c
        if slope <= 0:
            break
        step = (square * square - (first + second) * square - c * l + constant) / slope
        l -= step
        if abs(step) < ROOT_SETTLED:
            break
    return l


@compiled
def quest_quaternion(l, b, flip):
    """The papers' quaternion (4,), not yet of unit length, of B turned by a flip, for the eigenvalue l: QUEST's (x, gamma)."""
    sigma, s11, s22, s33, s12, s13, s23 = _symmetric(b, flip)
    z1, z2, z3, y1, y2, y3 = _twist(b, flip, s11, s22, s33, s12, s13, s23)
    minors, determinant = _minors_and_determinant(s11, s22, s33, s12, s13, s23)
    alpha, r = l * l - sigma * sigma + minors, l - sigma
    return np.array([alpha * z1 + r * y1 + s11 * y1 + s12 * y2 + s13 * y3, alpha * z2 + r * y2 + s12 * y1 + s22 * y2 + s23 * y3,
                     alpha * z3 + r * y3 + s13 * y1 + s23 * y2 + s33 * y3, alpha * (l + sigma) - determinant])


@compiled
def best_flip(l, b):
    """Which of FLIPS has the largest gamma."""
    best, chosen = -np.inf, 0
    for k in range(len(FLIPS)):
        gamma = quest_quaternion(l, b, FLIPS[k])[3]
        if gamma > best:
            best, chosen = gamma, k
    return chosen
