"""Compiled: the photon-weighted fit of a Gaussian of known shape to many small windows."""

from __future__ import annotations

from math import erf, exp, pi, sqrt

from ...kernels import any_order, compiled

MOST_STEPS = 12
LARGEST_STEP_PX = 0.7
NEGLIGIBLE = 0.2  # of the error bar times the width: leaves about a tenth of the error bar
FAINTEST_DN = 1e-3
SERIES_PRECISION = 1e-3
LARGEST_ORDER = 8
MISFIT_SIGMA = 3.0


@any_order
def _profile(out, order, centre, sigma):
    """out[n, i]: integral over pixel i of He_n(z) phi(z) dz, z = (x - centre) / sigma, for n = 0 .. order + 1."""
    side = out.shape[1]
    for i in range(side + 1):
        z = (i - 0.5 - centre) / sigma
        above, h0, h1 = 0.5 * erf(z * sqrt(0.5)), 0.0, -exp(-0.5 * z * z) / sqrt(2 * pi)
        for n in range(order + 2):
            if i < side:
                out[n, i] = -above
            if i:
                out[n, i - 1] += above
            above = h1  # the integral of He_(n+1) phi is -He_n phi
            h0, h1 = h1, z * h1 - n * h0


@compiled
def _invert(a, low, inverse):
    """Inverse of a symmetric positive definite (4, 4), scaled to unit diagonal first; False where it is not definite.
    low (4, 5), inverse (4, 4): room to work in."""
    for i in range(4):
        if not a[i, i] > 0:
            return False
        low[i, 4] = 1 / sqrt(a[i, i])
    for i in range(4):
        for j in range(i + 1):
            rest = a[i, j] * low[i, 4] * low[j, 4]
            for k in range(j):
                rest -= low[i, k] * low[j, k]
            if i == j:
                if not rest > 1e-10:
                    return False
                low[i, i] = sqrt(rest)
            else:
                low[i, j] = rest / low[j, j]
    for i in range(4):  # of the triangle
        inverse[i, i] = 1 / low[i, i]
        for j in range(i):
            rest = 0.0
            for k in range(j, i):
                rest -= low[i, k] * inverse[k, j]
            inverse[i, j] = rest / low[i, i]
    for i in range(4):
        for j in range(4):
            total = 0.0
            for k in range(max(i, j), 4):
                total += inverse[k, i] * inverse[k, j]
            a[i, j] = total * low[i, 4] * low[j, 4]
    return True


@any_order
def _linear(data, usable, light, used):
    """Flux and background by plain least squares (they enter linearly): the start. Flux 0 where the data do not tell."""
    p1 = p2 = d1 = pd = 0.0
    for k in range(len(data)):
        p = usable[k] * light[k]
        p1, p2, d1, pd = p1 + p, p2 + p * p, d1 + usable[k] * data[k], pd + p * data[k]
    if not (used > 4 and used * p2 > p1 * p1 * (1 + 1e-9)):
        return 0.0, 0.0
    flux = max((used * pd - p1 * d1) / (used * p2 - p1 * p1), FAINTEST_DN)
    return flux, (d1 - flux * p1) / used


@any_order
def _normal(data, usable, floor, light, by_x, by_y, flux, background, gain, model_error, normal, right):
    """Fills the normal matrix (4, 4) and the right side (4,) of one step; returns chi^2 before it."""
    xx = xy = yy = xf = yf = ff = xb = yb = fb = bb = rx = ry = rf = rb = chi2 = 0.0
    for k in range(len(data)):
        own = flux * light[k]
        weight = usable[k] / (floor[k] + gain * own + (model_error * own) ** 2)
        a, b, p, r = flux * by_x[k], flux * by_y[k], light[k], data[k] - background - own
        wa, wb, wp, wr = weight * a, weight * b, weight * p, weight * r
        xx, xy, yy, xf, yf = xx + wa * a, xy + wa * b, yy + wb * b, xf + wa * p, yf + wb * p
        ff, xb, yb, fb, bb = ff + wp * p, xb + wa, yb + wb, fb + wp, bb + weight
        rx, ry, rf, rb, chi2 = rx + wr * a, ry + wr * b, rf + wr * p, rb + wr, chi2 + wr * r
    normal[0, 0], normal[1, 0], normal[1, 1], normal[2, 0], normal[2, 1] = xx, xy, yy, xf, yf
    normal[2, 2], normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = ff, xb, yb, fb, bb
    right[0], right[1], right[2], right[3] = rx, ry, rf, rb
    return chi2


@compiled
def fit_known_shape(signal, floor, start_xy, moments, gain, model_error, profiles, pixels, small, out):
    """Gauss-Newton fit of position, flux and background, weights 1/variance with the variance from the model (Poisson).

    signal, floor: (N, n, n) float32, DN and DN^2 (variance of a pixel without the spot's own light); signal NaN has no
    weight. start_xy: (N, 2) in pixels of the window. moments: (N, 3), s_xx s_yy s_xy of the Gaussian, px^2, before the pixel.
    gain: DN per e- (0 leaves the spot's shot noise out). model_error: (N,), relative misfit of the shape, added to the
    variance as (model_error * light)^2.

    A tilted Gaussian is Mehler's series in its correlation, each term a product of two pixel integrals.

    A misfit is believed, and the covariance scaled up by it, where chi^2 per degree of freedom is beyond its expectation by
    MISFIT_SIGMA: noise alone must not widen the error bars.

    Room to work in: profiles (2, LARGEST_ORDER + 2, n), pixels (6, n * n), small (4, 4, 5).

    Fills out (N, 9): x, y, flux, background, covariance xx, xy, xy, yy of the position, converged (1 or 0).
    """
    count, side = signal.shape[0], signal.shape[1]
    across, down = profiles[0], profiles[1]
    light, by_x, by_y, data, usable, floor_s = pixels[0], pixels[1], pixels[2], pixels[3], pixels[4], pixels[5]
    normal, low, inverse, right, move = small[0], small[1], small[2], small[3, 0], small[3, 1]
    for s in range(count):
        for j in range(side):
            for i in range(side):
                d, k = signal[s, j, i], j * side + i
                good = d == d
                usable[k], data[k] = (1.0, d) if good else (0.0, 0.0)
                floor_s[k] = floor[s, j, i] if good else 1.0
        sx, sy = sqrt(moments[s, 0]), sqrt(moments[s, 1])
        rho = moments[s, 2] / (sx * sy)
        order, size = 0, abs(rho)
        while size > SERIES_PRECISION and order < LARGEST_ORDER:
            order, size = order + 1, size * abs(rho)
        x, y, flux, background = start_xy[s, 0], start_xy[s, 1], -1.0, 0.0
        chi2, gained, used, solved = 0.0, 0.0, 0.0, False
        for k in range(side * side):
            used += usable[k]
        for step in range(MOST_STEPS):
            _profile(across, order, x, sx)
            _profile(down, order, y, sy)
            for j in range(side if order == 0 else 0):
                for i in range(side):
                    k = j * side + i
                    light[k] = across[0, i] * down[0, j]
                    by_x[k], by_y[k] = across[1, i] * down[0, j] / sx, across[0, i] * down[1, j] / sy
            for j in range(side if order else 0):
                for i in range(side):
                    p, px, py, c = 0.0, 0.0, 0.0, 1.0
                    for n in range(order + 1):
                        p += c * across[n, i] * down[n, j]
                        px += c * across[n + 1, i] * down[n, j]
                        py += c * across[n, i] * down[n + 1, j]
                        c *= rho / (n + 1)
                    k = j * side + i
                    light[k], by_x[k], by_y[k] = p, px / sx, py / sy
            if step == 0:
                flux, background = _linear(data, usable, light, used)
                if not flux > 0:
                    break
            chi2 = _normal(data, usable, floor_s, light, by_x, by_y, flux, background, gain, model_error[s], normal, right)
            if not _invert(normal, low, inverse):
                break
            for i in range(4):
                move[i] = normal[i, 0] * right[0] + normal[i, 1] * right[1] + normal[i, 2] * right[2] + normal[i, 3] * right[3]
            gained = right[0] * move[0] + right[1] * move[1] + right[2] * move[2] + right[3] * move[3]
            length2 = move[0] ** 2 + move[1] ** 2
            short = min(1.0, LARGEST_STEP_PX / max(sqrt(length2), 1e-12))
            x, y, background = x + short * move[0], y + short * move[1], background + short * move[3]
            flux = max(flux + short * move[2], FAINTEST_DN)
            # The next step would be of order length^2 / width: stop where that is far below the error bar.
            if step and length2 < NEGLIGIBLE * min(sx, sy) * sqrt(min(normal[0, 0], normal[1, 1])):
                solved = True
                break
        near = max(abs(x - start_xy[s, 0]), abs(y - start_xy[s, 1])) < side / 2
        free = max(used - 4.0, 1.0)
        chi2 = (chi2 - gained) / free
        wider = chi2 if chi2 > 1 + MISFIT_SIGMA * sqrt(2 / free) else 1.0
        out[s, 0], out[s, 1], out[s, 2], out[s, 3] = x, y, flux, background
        out[s, 4], out[s, 5], out[s, 6], out[s, 7] = normal[0, 0], normal[0, 1], normal[0, 1], normal[1, 1]
        for k in range(4, 8):
            out[s, k] *= wider
        out[s, 8] = 1.0 if solved and near and flux > FAINTEST_DN else 0.0
