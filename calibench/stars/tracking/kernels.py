"""Compiled: the rotation that a track's spots agree on, its covariance, and what the residuals say of the lens."""

from __future__ import annotations

import math

import numpy as np

from ...geometry.kernels import bend_rational, solve3, turn_by, turned
from ...kernels import compiled

STEPS = 6


@compiled
def predict(directions, matrix, camera, terms, fold, width, height, edge, most):
    """The first `most` of the directions (N, 3) that a rational lens (as geometry's `unproject` takes it) puts on the frame,
    `edge` px inside: rows (K,), xy_px (K, 2), d xy / d direction in camera axes (K, 2, 3)."""
    rows, xy, by_v = np.empty(most, np.int64), np.empty((most, 2)), np.empty((most, 2, 3))
    u, count = np.empty(3), 0
    for n in range(len(directions)):
        turned(matrix, directions[n], u)
        if u[2] <= 0:
            continue
        x, y = camera[4] * u[0] / u[2], u[1] / u[2]
        if x * x + y * y >= fold * fold:
            continue
        xd, yd, xx, xy_, yx, yy = bend_rational(terms, x, y)
        px, py = camera[0] * xd + camera[5] * yd + camera[2], camera[1] * yd + camera[3]
        if px <= edge or py <= edge or px >= width - 1 - edge or py >= height - 1 - edge:
            continue
        rows[count], xy[count, 0], xy[count, 1] = n, px, py
        for r in range(2):
            of_x, of_y = camera[1] * yx, camera[1] * yy
            if r == 0:
                of_x, of_y = camera[0] * xx + camera[5] * yx, camera[0] * xy_ + camera[5] * yy
            by_v[count, r, 0], by_v[count, r, 1] = camera[4] * of_x / u[2], of_y / u[2]
            by_v[count, r, 2] = -(of_x * x + of_y * y) / u[2]
        count += 1
        if count == most:
            break
    return rows[:count], xy[:count], by_v[:count]


@compiled
def _normal(v, directions, by_v, covariance_px2, model_sd_px, softness, matrix, residual, by_turn, weight, information,
            gradient):
    """Residuals (M, 2) px, Jacobians (M, 2, 3), weights (M, 3): w_xx, w_yy, w_xy, and their sums, each star times softness."""
    u = np.empty(3)
    information[:] = 0.0
    gradient[:] = 0.0
    for m in range(len(v)):
        turned(matrix, directions[m], u)
        for r in range(2):
            residual[m, r] = 0.0
            for i in range(3):
                residual[m, r] += by_v[m, r, i] * (v[m, i] - u[i])
            for i in range(3):  # d u / d turn = -[u]x
                by_turn[m, r, i] = by_v[m, r, (i + 2) % 3] * u[(i + 1) % 3] - by_v[m, r, (i + 1) % 3] * u[(i + 2) % 3]
        a, c = covariance_px2[m, 0] + model_sd_px**2, covariance_px2[m, 1] + model_sd_px**2
        b = covariance_px2[m, 2]
        determinant = a * c - b * b
        weight[m, 0], weight[m, 1], weight[m, 2] = c / determinant, a / determinant, -b / determinant
        for i in range(3):
            gx, gy = by_turn[m, 0, i], by_turn[m, 1, i]
            wx, wy = weight[m, 0] * gx + weight[m, 2] * gy, weight[m, 2] * gx + weight[m, 1] * gy
            gradient[i] += softness[m] * (wx * residual[m, 0] + wy * residual[m, 1])
            for j in range(3):
                information[i, j] += softness[m] * (wx * by_turn[m, 0, j] + wy * by_turn[m, 1, j])


@compiled
def fit_track(v, directions, by_v, covariance_px2, model_sd_px, circle_px, fewest, matrix):
    """Rotation of measured directions v (M, 3) against star directions (M, 3), from `matrix`, which it changes in place.

    by_v (M, 2, 3): px by direction; covariance_px2 (M, 3): s_xx, s_yy, s_xy; circle_px (M,): how far a star may miss. Weighted
    Gauss-Newton; a star beyond its circle counts for less, the farther the less, until the rotation settles; then those
    within their circles alone.

    Returns:
        agreeing (M,) bool, residual_px (M, 2), by_turn (M, 2, 3), weight (M, 3).
    """
    n = len(v)
    residual, by_turn, weight = np.zeros((n, 2)), np.empty((n, 2, 3)), np.empty((n, 3))
    information, gradient, softness = np.empty((3, 3)), np.empty(3), np.ones(n)
    off = np.empty(n)
    for turn in range(STEPS):
        _normal(v, directions, by_v, covariance_px2, model_sd_px, softness, matrix, residual, by_turn, weight, information,
                gradient)
        for m in range(n):
            off[m] = math.sqrt(residual[m, 0] ** 2 + residual[m, 1] ** 2)
        closest = np.sort(off)[min(fewest, n) - 1]
        for m in range(n):
            limit = max(circle_px[m], closest)
            if turn < STEPS - 2:
                softness[m] = 1.0 if off[m] <= limit else (limit / off[m]) ** 4
            else:
                softness[m] = 1.0 if off[m] <= circle_px[m] else 0.0
        _normal(v, directions, by_v, covariance_px2, model_sd_px, softness, matrix, residual, by_turn, weight, information,
                gradient)
        _, step, determinant = solve3(information, gradient)
        if not determinant > 0:
            break
        turn_by(step, matrix)
    ones = np.ones(n)
    _normal(v, directions, by_v, covariance_px2, model_sd_px, ones, matrix, residual, by_turn, weight, information, gradient)
    agreeing = np.empty(n, np.bool_)
    for m in range(n):
        agreeing[m] = residual[m, 0] ** 2 + residual[m, 1] ** 2 <= circle_px[m] ** 2
    return agreeing, residual, by_turn, weight


@compiled
def spread_of(residual, by_turn, weight, covariance_px2, xy_px, centre_px):
    """Covariance (3, 3), rad^2, of a weighted fit to the stars given, from the spots' own covariance (M, 3); the smallest chi^2
    by that covariance; and, the rotation eliminated, normal matrix (3, 3) and gradient (3,) of relative focal length, cx, cy.
    """
    information, inner = np.zeros((3, 3)), np.zeros((3, 3))
    lens, mixed, pull, turned_pull = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    weighted, seen, by_lens, weighted_lens = np.empty((2, 3)), np.empty((2, 3)), np.zeros((2, 3)), np.empty((2, 3))
    by_lens[0, 1] = by_lens[1, 2] = 1.0
    chi2 = 0.0
    for m in range(len(residual)):
        wxx, wyy, wxy = weight[m]
        sxx, syy, sxy = covariance_px2[m]
        by_lens[0, 0], by_lens[1, 0] = xy_px[m, 0] - centre_px[0], xy_px[m, 1] - centre_px[1]
        for i in range(3):
            gx, gy = by_turn[m, 0, i], by_turn[m, 1, i]
            weighted[0, i], weighted[1, i] = wxx * gx + wxy * gy, wxy * gx + wyy * gy
            seen[0, i], seen[1, i] = (sxx * weighted[0, i] + sxy * weighted[1, i], sxy * weighted[0, i] + syy * weighted[1, i])
            hx, hy = by_lens[0, i], by_lens[1, i]
            weighted_lens[0, i], weighted_lens[1, i] = wxx * hx + wxy * hy, wxy * hx + wyy * hy
        for r in range(2):
            for i in range(3):
                pull[i] += weighted_lens[r, i] * residual[m, r]
                turned_pull[i] += weighted[r, i] * residual[m, r]
                for j in range(3):
                    information[i, j] += weighted[r, i] * by_turn[m, r, j]
                    inner[i, j] += weighted[r, i] * seen[r, j]
                    lens[i, j] += weighted_lens[r, i] * by_lens[r, j]
                    mixed[i, j] += weighted_lens[r, i] * by_turn[m, r, j]
        determinant = sxx * syy - sxy * sxy
        rx, ry = residual[m]
        chi2 += (syy * rx * rx - 2 * sxy * rx * ry + sxx * ry * ry) / determinant
    gain, _, _ = solve3(information, turned_pull)
    covariance, reduced, gradient = np.zeros((3, 3)), lens.copy(), pull.copy()
    for i in range(3):
        for j in range(3):
            for k in range(3):
                gradient[i] -= mixed[i, j] * gain[j, k] * turned_pull[k]
                for l in range(3):
                    covariance[i, j] += gain[i, k] * inner[k, l] * gain[l, j]
                    reduced[i, j] -= mixed[i, k] * gain[k, l] * mixed[j, l]
    return covariance, chi2, reduced, gradient
