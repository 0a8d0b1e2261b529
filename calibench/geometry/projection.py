"""Projection: directions in camera axes <-> raw (distorted) pixels, with Jacobians.

One form serves all models of `records.intrinsics` (OpenCV's rational model; the absent terms are zero):

    x = X/Z, y = Y/Z, u = x^2 + y^2
    g = (1 + k1 u + k2 u^2 + k3 u^3) / (1 + k4 u + k5 u^2 + k6 u^3)
    x' = x g + 2 p1 x y + p2 (u + 2 x^2)
    y' = y g + p1 (u + 2 y^2) + 2 p2 x y
    column = fx x' + cx, row = fy y' + cy          (a mirrored camera flips x first)

Beyond the radius where x' turns back (the lens model folds) two directions would share a pixel: there nothing is visible.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

from ..errors import BadInput
from ..records import Intrinsics

NEWTON_STEPS = 20


def _terms(intrinsics: Intrinsics) -> np.ndarray:
    """k1 k2 p1 p2 k3 k4 k5 k6 with absent ones zero (OpenCV's order)."""
    out = np.zeros(8)
    out[: len(intrinsics.distortion)] = intrinsics.distortion
    return out


def fold_radius(intrinsics: Intrinsics) -> float:
    """Normalised radius tan(theta) up to which the radial distortion is monotone; infinite where it never folds."""
    return _fold_radius(tuple(_terms(intrinsics).tolist()))


@lru_cache(maxsize=256)
def _fold_radius(terms: tuple[float, ...]) -> float:
    k1, k2, _, _, k3, k4, k5, k6 = terms
    n, d = Polynomial([1, k1, k2, k3]), Polynomial([1, k4, k5, k6])
    u = Polynomial([0, 1])
    slope = (n + 2 * u * n.deriv()) * d - 2 * u * n * d.deriv()  # d(r N/D)/dr times D^2, in u = r^2
    limits = []
    for polynomial in (slope, d):
        roots = polynomial.trim().roots()
        limits += [r.real for r in roots if abs(r.imag) < 1e-9 * max(1, abs(r)) and r.real > 0]
    return float(np.sqrt(min(limits))) if limits else np.inf


def _distort(k: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """x', y', their 2 x 2 derivative by (x, y), and what the parameter derivatives need (u, g, numerator, denominator)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    u = x * x + y * y
    n = 1 + u * (k1 + u * (k2 + u * k3))
    d = 1 + u * (k4 + u * (k5 + u * k6))
    g = n / d
    dg = ((k1 + u * (2 * k2 + 3 * u * k3)) - g * (k4 + u * (2 * k5 + 3 * u * k6))) / d  # dg/du
    xd = x * g + 2 * p1 * x * y + p2 * (u + 2 * x * x)
    yd = y * g + p1 * (u + 2 * y * y) + 2 * p2 * x * y
    xx = g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
    yy = g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x
    return xd, yd, xx, xy, yy, u, g, d


def _normalised(intrinsics: Intrinsics, v_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    v = np.asarray(v_cam, float)
    visible = v[:, 2] > 0
    z = np.where(visible, v[:, 2], np.nan)
    x, y = v[:, 0] / z, v[:, 1] / z
    inside = x * x + y * y < fold_radius(intrinsics) ** 2
    return np.where(inside, -x if intrinsics.mirrored else x, np.nan), np.where(inside, y, np.nan), z


def project(intrinsics: Intrinsics, v_cam: np.ndarray) -> np.ndarray:
    """Directions (N, 3) in camera axes -> (N, 2) raw pixels; NaN behind the camera and beyond the fold."""
    x, y, _ = _normalised(intrinsics, v_cam)
    xd, yd, *_ = _distort(_terms(intrinsics), x, y)
    return np.stack([intrinsics.fx_px * xd + intrinsics.cx_px, intrinsics.fy_px * yd + intrinsics.cy_px], -1)


def project_with_jacobian(intrinsics: Intrinsics, v_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `project`, with derivatives.

    Returns:
        xy_px (N, 2), d_xy_d_v (N, 2, 3), d_xy_d_parameters (N, 2, P) in the order of `intrinsics.parameter_names`.
    """
    x, y, z = _normalised(intrinsics, v_cam)
    xd, yd, xx, xy, yy, u, g, d = _distort(_terms(intrinsics), x, y)
    fx, fy = intrinsics.fx_px, intrinsics.fy_px
    pixels = np.stack([fx * xd + intrinsics.cx_px, fy * yd + intrinsics.cy_px], -1)
    by_normalised = np.stack([np.stack([fx * xx, fx * xy], -1), np.stack([fy * xy, fy * yy], -1)], -2)
    o = np.zeros_like(x)
    sign = -1.0 if intrinsics.mirrored else 1.0
    normalised_by_v = np.stack([np.stack([sign / z, o, -x / z], -1), np.stack([o, 1 / z, -y / z], -1)], -2)
    one = np.ones_like(x)
    columns = [np.stack([xd, o], -1), np.stack([o, yd], -1), np.stack([one, o], -1), np.stack([o, one], -1)]
    scaled_x, scaled_y = fx * x / d, fy * y / d
    distortion = [np.stack([scaled_x * u, scaled_y * u], -1), np.stack([scaled_x * u**2, scaled_y * u**2], -1),
                  np.stack([fx * 2 * x * y, fy * (u + 2 * y * y)], -1), np.stack([fx * (u + 2 * x * x), fy * 2 * x * y], -1),
                  np.stack([scaled_x * u**3, scaled_y * u**3], -1),
                  *(np.stack([-scaled_x * g * u**i, -scaled_y * g * u**i], -1) for i in (1, 2, 3))]
    columns += distortion[: len(intrinsics.distortion)]
    return pixels, by_normalised @ normalised_by_v, np.stack(columns, -1)


def _undistort(intrinsics: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
    """Normalised (x, y) by Newton steps from the distorted point, and the 2 x 2 derivative there."""
    xy = np.asarray(xy_px, float)
    k = _terms(intrinsics)
    xd = (xy[:, 0] - intrinsics.cx_px) / intrinsics.fx_px
    yd = (xy[:, 1] - intrinsics.cy_px) / intrinsics.fy_px
    x, y = xd.copy(), yd.copy()
    limit = fold_radius(intrinsics)
    if np.isfinite(limit):  # start inside the fold, or Newton may leave through it
        shrink = np.minimum(1.0, 0.95 * limit / np.maximum(np.hypot(x, y), 1e-300))
        x, y = x * shrink, y * shrink
    for _ in range(NEWTON_STEPS):
        ex, ey, xx, xy_, yy, *_ = _distort(k, x, y)
        ex, ey = xd - ex, yd - ey
        determinant = xx * yy - xy_ * xy_
        step_x, step_y = (yy * ex - xy_ * ey) / determinant, (xx * ey - xy_ * ex) / determinant
        x, y = x + step_x, y + step_y
        if not np.any(np.abs(step_x) + np.abs(step_y) > 1e-14):
            break
    ex, ey, xx, xy_, yy, *_ = _distort(k, x, y)
    bad = ~(np.hypot(xd - ex, yd - ey) < 1e-9) | ~(x * x + y * y < limit**2)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise BadInput(f"the lens model ({intrinsics.model}) cannot be inverted at pixel ({xy[i, 0]:.1f}, {xy[i, 1]:.1f}): "
                       f"it folds at radius {limit:.3f}",
                       mend="calibrate with views that reach the corners, or with fewer distortion terms")
    return x, y, (xx, xy_, yy)


def unproject(intrinsics: Intrinsics, xy_px: np.ndarray) -> np.ndarray:
    """Raw pixels (N, 2) -> unit vectors (N, 3) in camera axes.

    Raises:
        BadInput: a pixel lies where the lens model folds and has no direction.
    """
    x, y, _ = _undistort(intrinsics, xy_px)
    v = np.stack([-x if intrinsics.mirrored else x, y, np.ones_like(x)], -1)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def unproject_with_jacobian(intrinsics: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `unproject`, with d_v_d_xy (N, 3, 2), rad per px."""
    x, y, (xx, xy, yy) = _undistort(intrinsics, xy_px)
    determinant = xx * yy - xy * xy
    fx, fy = intrinsics.fx_px, intrinsics.fy_px
    sign = -1.0 if intrinsics.mirrored else 1.0
    by_pixel = np.stack([np.stack([yy / fx, -xy / fy], -1), np.stack([-xy / fx, xx / fy], -1)], -2) / determinant[:, None, None]
    by_pixel[:, 0] *= sign
    v = np.stack([sign * x, y, np.ones_like(x)], -1)
    length = np.linalg.norm(v, axis=-1)[:, None]
    v = v / length
    tangent = (np.eye(3)[:, :2] - v[:, :, None] * v[:, None, :2]) / length[:, :, None]
    return v, tangent @ by_pixel
