"""OpenCV's rational lens, with thin prism, in arrays of components of any one shape.

    x = X/Z, y = Y/Z, u = x^2 + y^2
    g = (1 + k1 u + k2 u^2 + k3 u^3) / (1 + k4 u + k5 u^2 + k6 u^3)
    x' = x g + 2 p1 x y + p2 (u + 2 x^2) + s1 u + s2 u^2
    y' = y g + p1 (u + 2 y^2) + 2 p2 x y + s3 u + s4 u^2

Terms stand in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; what a model lacks at the end is zero.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

TERMS = 12
NEWTON_STEPS = 20
Pair = tuple[np.ndarray, np.ndarray]


def _padded(terms: np.ndarray) -> list[float]:
    return [*np.asarray(terms).tolist(), *[0.0] * (TERMS - len(terms))]


@lru_cache(maxsize=256)
def fold_radius(terms: tuple[float, ...]) -> float:
    """tan of the angle up to which the radial distortion is monotone and finite; infinite where it never turns back."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(terms)[:8]
    n, d, power = np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6]), np.arange(4)
    slope = np.convolve((1 + 2 * power) * n, d) - np.convolve(n, 2 * power * d)  # d(r N/D)/dr times D^2, in u = r^2
    return float(np.sqrt(min(_first_root(slope), _first_root(d))))


def _first_root(coefficients: np.ndarray) -> float:
    """The smallest positive root of a polynomial (constant term 1 first), or infinity."""
    if (coefficients >= 0).all():
        return np.inf
    roots = np.roots(np.trim_zeros(coefficients, "b")[::-1])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(1, np.abs(roots))) & (roots.real > 0)]
    return float(real.min()) if len(real) else np.inf


def _bend(terms: np.ndarray, x: np.ndarray, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
    """x', y' and the radial factor g and denominator d (the scalar 1 for a lens without one)."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _padded(terms)
    g = k1 + u * (k2 + u * k3) if k3 else k1 + u * k2
    g = 1 + u * g
    d = 1.0
    if k4 or k5 or k6:
        d = 1 + u * (k4 + u * (k5 + u * k6))
        g = g / d
    tilt = g + 2 * (p1 * y + p2 * x)
    xd, yd = x * tilt + p2 * u, y * tilt + p1 * u
    if s1 or s2 or s3 or s4:
        xd, yd = xd + u * (s1 + s2 * u), yd + u * (s3 + s4 * u)
    return xd, yd, g, d


def _slope(terms: np.ndarray, x: np.ndarray, y: np.ndarray, u: np.ndarray, g: np.ndarray, d: np.ndarray) -> tuple:
    """dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _padded(terms)
    dg = (k1 + u * (2 * k2 + 3 * k3 * u)) if k3 else k1 + 2 * k2 * u  # dg/du
    if k4 or k5 or k6:
        dg = (dg - g * (k4 + u * (2 * k5 + 3 * k6 * u))) / d
    dg = 2 * dg
    p1y, p2x = 2 * p1 * y, 2 * p2 * x
    cross = x * y * dg + 2 * (p1 * x + p2 * y)
    xx, yy = g + x * x * dg + p1y + 3 * p2x, g + y * y * dg + 3 * p1y + p2x
    if not (s1 or s2 or s3 or s4):
        return xx, cross, cross, yy
    of_x, of_y = 2 * (s1 + 2 * s2 * u), 2 * (s3 + 2 * s4 * u)
    return xx + x * of_x, cross + y * of_x, cross + x * of_y, yy + y * of_y


def _by_terms(count: int, x: np.ndarray, y: np.ndarray, u: np.ndarray, g: np.ndarray, d: np.ndarray) -> list[Pair]:
    """Derivatives of (x', y') by the first `count` terms."""
    out: list[Pair] = []
    if not count:
        return out
    rx, ry = x * u / d, y * u / d
    r2x, r2y = rx * u, ry * u
    twice = 2 * x * y
    out += [(rx, ry), (r2x, r2y), (twice, u + 2 * y * y), (u + 2 * x * x, twice)]
    if count > 4:
        out += [(r2x * u, r2y * u)]
    if count > 5:
        out += [(-a * g, -b * g) for a, b in (out[0], out[1], out[4])]
    if count > 8:
        o, square = np.zeros_like(u), u * u
        out += [(u, o), (square, o), (o, u), (o, square)]
    return out


def bend(terms: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, *, jacobian: bool, past_fold: bool) -> tuple:
    """Directions (X, Y, Z) -> x', y'; NaN behind the camera and, unless past_fold, where the lens folds.

    Returns:
        (x', y'), and with `jacobian` the derivatives by X, Y, Z as two triples and those by the terms as a list of pairs
        (else None and an empty list).
    """
    inverse = 1 / np.where(z > 0, z, np.nan)
    x, y = x * inverse, y * inverse
    u = x * x + y * y
    if not past_fold:
        x = np.where(u < fold_radius(tuple(np.asarray(terms).tolist())) ** 2, x, np.nan)
    xd, yd, g, d = _bend(terms, x, y, u)
    if not jacobian:
        return (xd, yd), None, []
    xx, xy, yx, yy = (a * inverse for a in _slope(terms, x, y, u, g, d))
    by_v = (xx, xy, -(x * xx + y * xy)), (yx, yy, -(x * yx + y * yy))
    return (xd, yd), by_v, _by_terms(len(terms), x, y, u, g, d)


def straighten(terms: np.ndarray, xd: np.ndarray, yd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of `bend` on (N,) arrays by Newton steps: directions (N, 3) with Z = 1, and which (N,) have none."""
    x, y = xd.copy(), yd.copy()
    limit = fold_radius(tuple(np.asarray(terms).tolist()))
    if np.isfinite(limit):  # start inside the fold, or Newton may leave through it
        shrink = np.minimum(1.0, 0.95 * limit / np.maximum(np.hypot(x, y), 1e-300))
        x, y = x * shrink, y * shrink
    for _ in range(NEWTON_STEPS):
        u = x * x + y * y
        at_x, at_y, g, d = _bend(terms, x, y, u)
        xx, xy, yx, yy = _slope(terms, x, y, u, g, d)
        ex, ey = xd - at_x, yd - at_y
        determinant = xx * yy - xy * yx
        step_x, step_y = (yy * ex - xy * ey) / determinant, (xx * ey - yx * ex) / determinant
        x, y = x + step_x, y + step_y
        if not np.any(np.abs(step_x) + np.abs(step_y) > 1e-14):
            break
    u = x * x + y * y
    at_x, at_y, *_ = _bend(terms, x, y, u)
    bad = ~(np.hypot(xd - at_x, yd - at_y) < 1e-9) | ~(u < limit**2)
    return np.stack([x, y, np.ones_like(x)], -1), bad
