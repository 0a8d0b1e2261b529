"""The fisheye of Kannala and Brandt (2006, IEEE TPAMI 28, eq. 6) as OpenCV writes it, in arrays of components of one shape.

    r = hypot(X, Y), t = atan2(r, Z), h = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    x' = h X / r, y' = h Y / r

It sees past 90 degrees from the axis: visible is what lies below the angle where h turns back, at most 180 degrees.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

NEWTON_STEPS = 30
NEAR_AXIS = 1e-8


@lru_cache(maxsize=256)
def fold_angle(terms: tuple[float, ...]) -> float:
    """Angle from the axis, rad, up to which the image radius grows; pi where it never turns back."""
    slope = Polynomial([1, *((2 * i + 3) * k for i, k in enumerate(terms))])  # dh/dt in t^2
    roots = slope.trim().roots()
    limits = [r.real for r in roots if abs(r.imag) < 1e-9 * max(1, abs(r)) and r.real > 0]
    return min(float(np.sqrt(min(limits))), np.pi) if limits else np.pi


def fold_radius(terms: tuple[float, ...]) -> float:
    """tan of `fold_angle`; infinite where the lens sees 90 degrees and more."""
    angle = fold_angle(terms)
    return float(np.tan(angle)) if angle < np.pi / 2 else np.inf


def _radius(terms: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """h and dh/dt."""
    h = Polynomial([0, 1, *(k for term in np.asarray(terms).tolist() for k in (0, term))])
    return h(t), h.deriv()(t)


def bend(terms: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, *, jacobian: bool, past_fold: bool) -> tuple:
    """As `_rational.bend`."""
    r = np.hypot(x, y)
    t = np.arctan2(r, z)
    if not past_fold:
        t = np.where(t < fold_angle(tuple(np.asarray(terms).tolist())), t, np.nan)
    h, slope = _radius(terms, t)
    on_axis = r < NEAR_AXIS * np.abs(z)
    safe = np.where(on_axis, 1.0, r)
    scale = np.where(on_axis, 1 / np.where(z == 0, np.nan, z), h / safe)  # x' = scale X
    xd, yd = x * scale, y * scale
    if not jacobian:
        return (xd, yd), None, []
    length2 = r * r + z * z
    along = slope * z / length2  # d h / d r
    grow = np.where(on_axis, 0.0, (along - scale) / (safe * safe))  # of scale with r, over r
    by_z = -slope / length2
    cos, sin = np.where(on_axis, x / np.abs(z), x / safe), np.where(on_axis, y / np.abs(z), y / safe)
    cross = x * y * grow
    by_v = ((scale + x * x * grow, cross, by_z * r * cos), (cross, scale + y * y * grow, by_z * r * sin))
    by_terms = [(t ** (2 * i + 3) * cos, t ** (2 * i + 3) * sin) for i in range(len(terms))]
    return (xd, yd), by_v, by_terms


def straighten(terms: np.ndarray, xd: np.ndarray, yd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of `bend` on (N,) arrays: unit directions (N, 3), and which (N,) have none."""
    h = np.hypot(xd, yd)
    limit = fold_angle(tuple(np.asarray(terms).tolist()))
    low, high = np.zeros_like(h), np.full_like(h, limit)
    t = np.minimum(h, 0.95 * limit)
    for _ in range(NEWTON_STEPS):  # Newton, halving where it leaves the bracket: h grows all the way to the fold
        at, slope = _radius(terms, t)
        low, high = np.where(at < h, t, low), np.where(at < h, high, t)
        moved = t + (h - at) / slope
        moved = np.where((moved >= low) & (moved <= high), moved, (low + high) / 2)
        small = np.abs(moved - t) < 1e-15
        t = moved
        if small.all():
            break
    bad = ~(np.abs(_radius(terms, t)[0] - h) < 1e-9)
    safe = np.where(h > 0, h, 1.0)
    return np.stack([np.sin(t) * xd / safe, np.sin(t) * yd / safe, np.cos(t)], -1), bad
