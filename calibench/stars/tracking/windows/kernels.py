"""Compiled: what stands in the windows about predicted places, and the fit of light drawn along a trail."""

from __future__ import annotations

import math

import numpy as np

from ....geometry.kernels import factor_definite, inverse_of_first_two, solve_definite
from ....kernels import compiled
from ...kernels import widening

DETECTED_SIGMA = 5.0  # of the light in 3 x 3 pixels over its noise
CENTRING_STEPS, TRAIL_STEPS = 8, 6
QUARTILES = 1.349  # distance of a Gaussian's quartiles, sigma
QUANTISATION_DN2 = 1 / 12
NODE = 0.28867513459481287  # 2 x 2 Gauss-Legendre nodes of a pixel


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
def locate(signal, defects, unusable, read_variance, gain, reach, radius):
    """The brightest 3 x 3 pixels of each window (N, n, n), n = 2 (reach + radius) + 1, at most `reach` from its middle.

    signal: corrected, NaN beyond the frame's edge. defects: flags; those in `unusable` make a pixel lost. read_variance (N,),
    gain: what the map knows of the noise; 0 where it knows nothing.

    Returns:
        (N, 6): x, y in the window, light of the 3 x 3, background by the window's border, noise^2 by it, DN; peak. NaN where
        nothing stands out by DETECTED_SIGMA, or a lost pixel or the frame's edge is within `radius` of it.
    """
    side = signal.shape[1]
    out, border = np.full((len(signal), 6), np.nan), np.empty(4 * side)
    for k in range(len(signal)):
        count, window = 0, signal[k]
        for j in range(side):
            for i in range(side):
                value = window[j, i]
                if (i + j) % 2 or not (j == 0 or i == 0 or j == side - 1 or i == side - 1) or not value == value or (
                        defects[k, j, i] & unusable):
                    continue
                m = count  # sorted by insertion
                while m > 0 and border[m - 1] > value:
                    border[m] = border[m - 1]
                    m -= 1
                border[m] = value
                count += 1
        if count < side:
            continue
        background = border[count // 2]
        noise2 = max(((border[3 * count // 4] - border[count // 4]) / QUARTILES) ** 2,
                     read_variance[k] + gain * max(background, 0.0), QUANTISATION_DN2)
        best, bx, by = DETECTED_SIGMA * 3 * math.sqrt(noise2), -1, -1
        for j in range(radius, side - radius):
            for i in range(radius, side - radius):
                total = -9 * background
                for v in range(-1, 2):
                    total += window[j + v, i - 1] + window[j + v, i] + window[j + v, i + 1]
                if total > best:
                    best, bx, by = total, i, j
        if bx < 0:
            continue
        sx = sy = peak = 0.0
        for v in range(-1, 2):
            for u in range(-1, 2):
                value = window[by + v, bx + u] - background
                sx, sy, peak = sx + u * value, sy + v * value, max(peak, value)
        good = True  # a place that a defect touches is not to be trusted
        for j in range(by - radius, by + radius + 1):
            for i in range(bx - radius, bx + radius + 1):
                good = good and window[j, i] == window[j, i] and not defects[k, j, i] & unusable
        if good:
            out[k, 0], out[k, 1], out[k, 2] = bx + sx / best, by + sy / best, best
            out[k, 3], out[k, 4], out[k, 5] = background, noise2, peak
    return out


@compiled
def fit_trails(signal, floor, start, shape_px2, trail_px, radius, gain_dn_per_e):
    """Poisson-weighted Gauss-Newton of x, y, flux and background of spots drawn along trail_px (N, 2), over (2 radius + 1)^2
    pixels that follow the trail through its window.

    signal, floor: (N, n, n) float32, DN above background (NaN: not used) and variance without the star. start: (N, 3), x, y in
    the window and light of the brightest 3 x 3. shape_px2 (N, 3): the PSF's moments s_xx, s_yy, s_xy.

    Returns:
        (N, 7): x, y in the window, s_xx, s_yy, s_xy of their covariance (px^2), flux, background left over; NaN where it fails.
    """
    n, side = 2 * radius + 1, signal.shape[1]
    out, model, smooth = np.full((len(signal), 7), np.nan), np.empty((3, n, n)), np.empty(3)
    theta, gradient, slopes, normal = np.empty(4), np.empty(4), np.empty(4), np.empty((4, 4))
    for k in range(len(signal)):
        window, trail = signal[k], trail_px[k]
        theta[0], theta[1], theta[2], theta[3] = start[k, 0], start[k, 1], start[k, 2], 0.0
        smooth[0], smooth[1] = shape_px2[k, 0] + trail[0] ** 2 / 12, shape_px2[k, 1] + trail[1] ** 2 / 12
        smooth[2] = shape_px2[k, 2] + trail[0] * trail[1] / 12
        good = True
        for _ in range(CENTRING_STEPS):  # a trail's brightest pixels may be at either end
            cx, cy = int(round(theta[0])), int(round(theta[1]))
            if cx < radius or cy < radius or cx >= side - radius or cy >= side - radius:
                good = False
                break
            _point(model, theta[0] - cx + radius, theta[1] - cy + radius, smooth)
            s0 = sx = sy = 0.0
            for j in range(n):
                for i in range(n):
                    value = window[cy - radius + j, cx - radius + i]
                    if value == value:
                        light = model[0, j, i] * value
                        s0 += light
                        sx += light * (cx - radius + i - theta[0])
                        sy += light * (cy - radius + j - theta[1])
            if not s0 > 0:
                good = False
                break
            theta[0], theta[1], theta[2] = theta[0] + 2 * sx / s0, theta[1] + 2 * sy / s0, start[k, 2] * n / 3
        chi2, used = 0.0, 0
        for turn in range(TRAIL_STEPS + 1):
            cx, cy = int(round(theta[0])), int(round(theta[1]))
            if not good or cx < radius or cy < radius or cx >= side - radius or cy >= side - radius:
                good = False
                break
            _trail(model, theta[0] - cx + radius, theta[1] - cy + radius, shape_px2[k], trail)
            normal[:] = 0.0
            gradient[:] = 0.0
            chi2, used = 0.0, 0
            for j in range(n):
                for i in range(n):
                    value = window[cy - radius + j, cx - radius + i]
                    if not value == value:
                        continue
                    light = theta[2] * model[0, j, i]
                    weight = 1 / (floor[k, cy - radius + j, cx - radius + i] + gain_dn_per_e * max(light, 0.0))
                    rest = value - theta[3] - light
                    slopes[0], slopes[1] = theta[2] * model[1, j, i], theta[2] * model[2, j, i]
                    slopes[2], slopes[3] = model[0, j, i], 1.0
                    for p in range(4):
                        gradient[p] += weight * slopes[p] * rest
                        for q in range(p + 1):
                            normal[p, q] += weight * slopes[p] * slopes[q]
                    chi2, used = chi2 + weight * rest * rest, used + 1
            if turn < TRAIL_STEPS:
                good = good and used > 4 and solve_definite(normal, gradient)
                for p in range(4):
                    theta[p] += gradient[p]
        if not good or not theta[2] > 0 or not factor_definite(normal):
            continue
        freedom = used - 4
        scale = widening(chi2, freedom)
        xx, yy, xy = inverse_of_first_two(normal, gradient)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = theta[0], theta[1], xx * scale, yy * scale, xy * scale
        out[k, 5], out[k, 6] = theta[2], theta[3]
    return out
