"""Compiled: centroids in windows about predicted places, straight from the raw frame and the map's layers."""

from __future__ import annotations

import math

import numpy as np

from ....geometry.kernels import factor_definite, inverse_of_first_two, solve_definite
from ....kernels import compiled

DETECTED_SIGMA = 5.0  # of the light in 3 x 3 pixels over its noise
CENTRING_STEPS, POINT_STEPS, TRAIL_STEPS = 8, 2, 6
QUARTILES = 1.349  # distance of a Gaussian's quartiles, sigma
SURPRISE = 3.0  # chi^2 this many sigma above its expectation widens the covariance
NODE = 0.28867513459481287  # 2 x 2 Gauss-Legendre nodes of a pixel
SHORT_PX = 0.5  # a trail shorter than this is a point


@compiled
def _point(model, dx, dy, shape):
    """Light per pixel of a Gaussian (s_xx, s_yy, s_xy) centred (dx, dy) from the first pixel: model (3, n, n): light, and its
    slopes by the centre. Along a row each value is the last times a factor that is itself a geometric series."""
    n = model.shape[1]
    light, by_x, by_y = model[0], model[1], model[2]
    determinant = shape[0] * shape[1] - shape[2] * shape[2]
    a, b, c = shape[1] / determinant, -shape[2] / determinant, shape[0] / determinant
    norm, bend = 0.25 / (2 * math.pi * math.sqrt(determinant)), math.exp(-a)
    model[:] = 0.0
    for j in range(n):
        for node in range(4):
            v, u = j - dy + (NODE if node < 2 else -NODE), -dx + (NODE if node % 2 else -NODE)
            g = norm * math.exp(-0.5 * (a * u * u + 2 * b * u * v + c * v * v))
            factor = math.exp(-(a * (u + 0.5) + b * v))
            for i in range(n):
                light[j, i] += g
                by_x[j, i] += g * (a * u + b * v)
                by_y[j, i] += g * (b * u + c * v)
                g, factor, u = g * factor, factor * bend, u + 1.0


@compiled
def _trail(model, dx, dy, shape, trail):
    """As `_point`, for light that ran evenly along trail (2,) px with its middle at (dx, dy): exact along the trail for a round
    PSF, and for others with the variances along and across it."""
    n = model.shape[1]
    length = math.sqrt(trail[0] ** 2 + trail[1] ** 2)
    ex, ey = trail[0] / length, trail[1] / length
    along = math.sqrt(ex * ex * shape[0] + ey * ey * shape[1] + 2 * ex * ey * shape[2])
    across = math.sqrt(ey * ey * shape[0] + ex * ex * shape[1] - 2 * ex * ey * shape[2])
    root, flat = math.sqrt(2.0) * along, math.sqrt(2 * math.pi)
    model[:] = 0.0
    for j in range(n):
        for i in range(n):
            for node in range(4):
                v, u = j - dy + (NODE if node < 2 else -NODE), i - dx + (NODE if node % 2 else -NODE)
                p, q = ex * u + ey * v, ex * v - ey * u
                side = 0.25 * math.exp(-0.5 * (q / across) ** 2) / (flat * across)
                ahead, behind = p + length / 2, p - length / 2
                value = side * (math.erf(ahead / root) - math.erf(behind / root)) / (2 * length)
                by_p = side * (math.exp(-(behind / root) ** 2) - math.exp(-(ahead / root) ** 2)) / (flat * along * length)
                by_q = value * q / across**2
                model[0, j, i] += value
                model[1, j, i] += by_p * ex - by_q * ey
                model[2, j, i] += by_p * ey + by_q * ex


@compiled
def measure_windows(data, level_dn, response, bad, saturation_dn, xy_px, shape_px2, trail_px, reach, radius, gain_dn_per_e,
                    read_variance_dn2):
    """Spots at predicted places (N, 2), at most `reach` pixels off.

    Signal = (data - level) / response; background and noise from the window's border; place of the brightest 3 x 3 pixels;
    Poisson-weighted Gauss-Newton of x, y, flux and background over (2 radius + 1)^2 pixels, for the PSF's moments shape_px2
    (N, 3), s_xx, s_yy, s_xy, drawn along trail_px (N, 2). gain 0: not known.

    Returns:
        (N, 8): x, y, s_xx, s_yy, s_xy of their covariance (px^2), flux (DN), peak (DN), background (DN); NaN where nothing
        stands out, the fit fails, or a defect, saturation or the frame's edge is in the way.
    """
    h, w = data.shape
    out = np.full((len(xy_px), 8), np.nan)
    half, n = reach + radius, 2 * radius + 1
    side = 2 * half + 1
    signal, usable = np.empty((side, side)), np.empty((side, side), np.bool_)
    border, model, smooth = np.empty(4 * side), np.empty((3, n, n)), np.empty(3)
    theta, gradient, slopes, normal = np.empty(4), np.empty(4), np.empty(4), np.empty((4, 4))
    for k in range(len(xy_px)):
        x0, y0 = int(round(xy_px[k, 0])) - half, int(round(xy_px[k, 1])) - half
        if x0 + reach < 0 or y0 + reach < 0 or x0 + half + radius >= w or y0 + half + radius >= h:
            continue
        count = 0
        for j in range(side):
            for i in range(side):
                y, x = y0 + j, x0 + i
                inside = 0 <= y < h and 0 <= x < w
                usable[j, i] = inside and not bad[y, x] and data[y, x] < saturation_dn
                signal[j, i] = (data[y, x] - level_dn[y, x]) / response[y, x] if inside else 0.0
                if usable[j, i] and (i + j) % 2 == 0 and (j == 0 or i == 0 or j == side - 1 or i == side - 1):
                    value, m = signal[j, i], count
                    while m > 0 and border[m - 1] > value:
                        border[m] = border[m - 1]
                        m -= 1
                    border[m] = value
                    count += 1
        if count < side:
            continue
        background = border[count // 2]
        noise2 = max(((border[3 * count // 4] - border[count // 4]) / QUARTILES) ** 2, read_variance_dn2, 1.0 / 12)
        best, bx, by = DETECTED_SIGMA * 3 * math.sqrt(noise2), -1, -1
        for j in range(radius, side - radius):
            for i in range(radius, side - radius):
                total = -9 * background
                for v in range(-1, 2):
                    total += signal[j + v, i - 1] + signal[j + v, i] + signal[j + v, i + 1]
                if total > best:
                    best, bx, by = total, i, j
        if bx < 0:
            continue
        drawn = trail_px[k, 0] ** 2 + trail_px[k, 1] ** 2 > SHORT_PX**2
        sx = sy = 0.0
        for v in range(-1, 2):
            for u in range(-1, 2):
                sx += u * (signal[by + v, bx + u] - background)
                sy += v * (signal[by + v, bx + u] - background)
        theta[0], theta[1], theta[2], theta[3] = bx + sx / best, by + sy / best, best, background
        smooth[0], smooth[1] = shape_px2[k, 0] + trail_px[k, 0] ** 2 / 12, shape_px2[k, 1] + trail_px[k, 1] ** 2 / 12
        smooth[2] = shape_px2[k, 2] + trail_px[k, 0] * trail_px[k, 1] / 12
        good = True
        for _ in range(CENTRING_STEPS if drawn else 0):  # a trail's brightest pixels may be at either end
            cx, cy = int(round(theta[0])), int(round(theta[1]))
            if cx < radius or cy < radius or cx >= side - radius or cy >= side - radius:
                good = False
                break
            _point(model, theta[0] - cx + radius, theta[1] - cy + radius, smooth)
            s0 = sx = sy = 0.0
            for j in range(n):
                for i in range(n):
                    light = model[0, j, i] * (signal[cy - radius + j, cx - radius + i] - background)
                    s0 += light
                    sx += light * (cx - radius + i - theta[0])
                    sy += light * (cy - radius + j - theta[1])
            if not s0 > 0:
                good = False
                break
            theta[0], theta[1], theta[2] = theta[0] + 2 * sx / s0, theta[1] + 2 * sy / s0, best * n / 3
        chi2 = 0.0
        steps = TRAIL_STEPS if drawn else POINT_STEPS
        for turn in range(steps + 1):
            cx, cy = int(round(theta[0])), int(round(theta[1]))
            if not good or cx < radius or cy < radius or cx >= side - radius or cy >= side - radius:
                good = False
                break
            if drawn:
                _trail(model, theta[0] - cx + radius, theta[1] - cy + radius, shape_px2[k], trail_px[k])
            else:
                _point(model, theta[0] - cx + radius, theta[1] - cy + radius, shape_px2[k])
            normal[:] = 0.0
            gradient[:] = 0.0
            chi2 = 0.0
            for j in range(n):
                for i in range(n):
                    if not usable[cy - radius + j, cx - radius + i]:
                        good = False  # a place that a defect touches is not to be trusted
                    light = theta[2] * model[0, j, i]
                    weight = 1 / (noise2 + gain_dn_per_e * max(light, 0.0))
                    rest = signal[cy - radius + j, cx - radius + i] - theta[3] - light
                    slopes[0], slopes[1] = theta[2] * model[1, j, i], theta[2] * model[2, j, i]
                    slopes[2], slopes[3] = model[0, j, i], 1.0
                    for p in range(4):
                        gradient[p] += weight * slopes[p] * rest
                        for q in range(p + 1):
                            normal[p, q] += weight * slopes[p] * slopes[q]
                    chi2 += weight * rest * rest
            if turn < steps:
                good = good and solve_definite(normal, gradient)
                for p in range(4):
                    theta[p] += gradient[p]
        if not good or not theta[2] > 0 or not factor_definite(normal):
            continue
        freedom = n * n - 4
        scale = chi2 / freedom if chi2 > freedom + SURPRISE * math.sqrt(2.0 * freedom) else 1.0
        out[k, 0], out[k, 1] = x0 + theta[0], y0 + theta[1]
        xx, yy, xy = inverse_of_first_two(normal, gradient)
        out[k, 2], out[k, 3], out[k, 4] = xx * scale, yy * scale, xy * scale
        out[k, 5], out[k, 6], out[k, 7] = theta[2], theta[2] * model[0, radius, radius], theta[3]
    return out
