"""The compiled fit of the PSF map's image to one small window after the other."""

from __future__ import annotations

import math

import numpy as np

from ...geometry.kernels import inverse_of_first_two, solve_definite
from ...kernels import compiled

STEPS = 8
SETTLED_PX = 2e-3  # the step that follows is of its square's order
LARGEST_STEP_PX = 0.7


@compiled
def _along(at_px, scale_px, order, pixels, roots, edges, values, slopes):
    """Functions integrated over pixels at at_px, at_px + 1, ... from the centre (spots/hermite.along).

    roots (3, order + 1): 1/sqrt(n + 1), sqrt(n/(n + 1)) and 1/sqrt(n), because roots and quotients are what costs here.
    """
    last, per_px = 0.0, 1.0 / scale_px
    for i in range(pixels + 1):
        x = (at_px - 0.5 + i) * per_px
        edges[0] = math.exp(-0.5 * x * x) * 0.3989422804014327
        edges[1] = x * edges[0]
        for n in range(1, order):
            edges[n + 1] = roots[0, n] * x * edges[n] - roots[1, n] * edges[n - 1]
        below = 0.5 * math.erf(x * 0.7071067811865476)
        for n in range(order + 1):
            if i > 0:
                slopes[n, i - 1] += edges[n] * per_px
            if i < pixels:
                slopes[n, i] = -edges[n] * per_px
        if i > 0:
            values[0, i - 1] = below - last
        last = below
    for n in range(1, order + 1):
        factor = -scale_px * roots[2, n]
        for i in range(pixels):
            values[n, i] = factor * slopes[n - 1, i]


@compiled
def _add(core, order, x, x_slope, y, y_slope, pixels, unit, by_x, by_y, line, line_slope):
    """Adds sum core[m, n] y_m x_n and its slopes to the images."""
    for m in range(order + 1):
        for i in range(pixels):
            line[i] = 0.0
            line_slope[i] = 0.0
        for n in range(order + 1 - m):
            c = core[m, n]
            for i in range(pixels):
                line[i] += c * x[n, i]
                line_slope[i] += c * x_slope[n, i]
        for j in range(pixels):
            a, b = y[m, j], y_slope[m, j]
            for i in range(pixels):
                unit[j, i] += a * line[i]
                by_x[j, i] += a * line_slope[i]
                by_y[j, i] += b * line[i]


@compiled
def fit_shapes(signal_dn, floor_dn2, xy_px, core, wings, scale_px, wing_scale_px, gain_dn_per_e, misfit, radius):
    """Poisson-weighted Gauss-Newton of x, y, flux and background, one spot after the other.

    signal_dn, floor_dn2: (N, S, S) float32, windows, S a little larger than 2 radius + 1; signal NaN has no weight. xy_px
    (N, 2) start, pixels of the window. core (N, P, P), wings (N, 3, 3): coefficients [order along y, order along x] of each
    spot. misfit (N,): of the shape, as a share of the peak: it adds to the variance of a pixel (misfit F)^2 times its share
    of light and the peak's.

    Returns (N, 9): x, y, flux_dn, background_dn, covariance xx, yy, xy (px^2), chi2 per degree of freedom, pixels used;
    NaN where the fit failed.
    """
    room = signal_dn.shape[1] - 2 * radius - 1
    count, top, side = len(xy_px), core.shape[1] - 1, 2 * radius + 1
    out = np.full((count, 9), np.nan)
    orders = np.arange(max(top, 2) + 1.0)
    roots = np.stack((1 / np.sqrt(orders + 1), np.sqrt(orders / (orders + 1)), 1 / np.sqrt(np.maximum(orders, 1.0))))
    edges = np.empty(len(orders))
    x, dx, y, dy = (np.empty((top + 1, side)), np.empty((top + 1, side)), np.empty((top + 1, side)), np.empty((top + 1, side)))
    vx, dvx, vy, dvy = np.empty((3, side)), np.empty((3, side)), np.empty((3, side)), np.empty((3, side))
    unit, by_x, by_y = np.empty((side, side)), np.empty((side, side)), np.empty((side, side))
    line, line_slope = np.empty(side), np.empty(side)
    normal, right, part = np.empty((4, 4)), np.empty(4), np.empty(4)
    for s in range(count):
        px, py, data, floor = xy_px[s, 0], xy_px[s, 1], signal_dn[s], floor_dn2[s]
        flux, background = 0.0, 0.0
        settled = False
        for step in range(STEPS):
            if step < 3:  # the window follows the first steps
                left = min(max(int(round(px)) - radius, 0), room)
                above = min(max(int(round(py)) - radius, 0), room)
            _along(left - px, scale_px, top, side, roots, edges, x, dx)
            _along(above - py, scale_px, top, side, roots, edges, y, dy)
            _along(left - px, wing_scale_px, 2, side, roots, edges, vx, dvx)
            _along(above - py, wing_scale_px, 2, side, roots, edges, vy, dvy)
            unit[:], by_x[:], by_y[:] = 0.0, 0.0, 0.0
            _add(core[s], top, x, dx, y, dy, side, unit, by_x, by_y, line, line_slope)
            _add(wings[s], 2, vx, dvx, vy, dvy, side, unit, by_x, by_y, line, line_slope)
            peak = unit.max()
            if step == 0:  # a linear start for the flux, unweighted
                a = b = 0.0
                for j in range(side):
                    for i in range(side):
                        value = data[above + j, left + i]
                        if value == value:
                            a += unit[j, i] * value
                            b += unit[j, i] * unit[j, i]
                flux = max(a / b, 1e-6) if b > 0.0 else 1e-6
            normal[:], right[:] = 0.0, 0.0
            chi2, pixels = 0.0, 0
            shot = gain_dn_per_e + misfit[s] * misfit[s] * flux * peak
            for j in range(side):
                for i in range(side):
                    value = data[above + j, left + i]
                    if not value == value:
                        continue
                    model = flux * unit[j, i]
                    weight = 1.0 / (floor[above + j, left + i] + shot * max(model, 0.0))
                    residual = value - background - model
                    part[0], part[1], part[2], part[3] = -flux * by_x[j, i], -flux * by_y[j, i], unit[j, i], 1.0
                    for m in range(4):
                        right[m] += weight * part[m] * residual
                        for n in range(m + 1):
                            normal[m, n] += weight * part[m] * part[n]
                    chi2 += weight * residual * residual
                    pixels += 1
            if pixels < 5 or not solve_definite(normal, right):
                break
            length = math.hypot(right[0], right[1])
            shrink = min(1.0, LARGEST_STEP_PX / length) if length > 0.0 else 1.0
            px += shrink * right[0]
            py += shrink * right[1]
            flux = max(flux + right[2], 1e-6)
            background += right[3]
            if abs(px - xy_px[s, 0]) > radius or abs(py - xy_px[s, 1]) > radius:
                break
            if length < SETTLED_PX and step > 0:
                settled = True
                break
        if settled and flux > 1e-6:
            out[s, 0], out[s, 1], out[s, 2], out[s, 3] = px, py, flux, background
            out[s, 4], out[s, 5], out[s, 6] = inverse_of_first_two(normal, right)
            out[s, 7] = chi2 / max(pixels - 4, 1)
            out[s, 8] = pixels
    return out
