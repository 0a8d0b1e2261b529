"""Fit of an elliptical Gaussian, integrated over pixels, to many small windows at once.

    model(p) = background + flux * integral over pixel p of N(c, S)

The pixel integral is a 3x3 Gauss-Legendre rule (error below 1e-3 of the peak for sigma >= 0.4 px). Gauss-Newton with weights
1/variance, the variance of a pixel taken from the model of the last step (Poisson), so that the estimate reaches the
Cramer-Rao bound. Shape S is given, or free (three more parameters). Positions are (x, y), pixel (0, 0) a centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cut import cut
from .scene import Patches

NODES = np.sqrt(0.6) / 2 * np.array([-1.0, 0.0, 1.0])
NODE_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18
STEPS = 12
CONVERGED_PX = 1e-4
LARGEST_STEP_PX = 0.7


@dataclass(frozen=True, kw_only=True)
class GaussianFit:
    """Fitted spots: xy_px (N, 2), flux_dn, background_dn (N,), moments_px2 (N, 3) of s_xx s_yy s_xy, chi2_per_dof (N,),
    converged (N,) bool, covariance (N, P, P) in the order x, y, flux, background(, s_xx, s_yy, s_xy)."""

    xy_px: np.ndarray
    flux_dn: np.ndarray
    background_dn: np.ndarray
    moments_px2: np.ndarray
    covariance: np.ndarray
    chi2_per_dof: np.ndarray
    converged: np.ndarray


def _model(xy: np.ndarray, pixels: np.ndarray, s: np.ndarray, with_shape: bool) -> tuple[np.ndarray, np.ndarray]:
    """Unit-flux model (N, M) and its derivatives (N, M, 2 or 5) by x, y(, s_xx, s_yy, s_xy)."""
    determinant = s[:, 0] * s[:, 1] - s[:, 2] ** 2
    pxx, pyy, pxy = (v[:, None] for v in (s[:, 1] / determinant, s[:, 0] / determinant, -s[:, 2] / determinant))
    norm = (1 / (2 * np.pi * np.sqrt(determinant)))[:, None]
    delta = pixels - xy[:, None, :]
    total = np.zeros(delta.shape[:2])
    slopes = np.zeros((*delta.shape[:2], 5 if with_shape else 2))
    for i, wi in zip(NODES, NODE_WEIGHTS, strict=True):
        for j, wj in zip(NODES, NODE_WEIGHTS, strict=True):
            dx, dy = delta[..., 0] + i, delta[..., 1] + j
            ax, ay = pxx * dx + pxy * dy, pxy * dx + pyy * dy
            g = wi * wj * norm * np.exp(-0.5 * (dx * ax + dy * ay))
            total += g
            slopes[..., 0] += g * ax
            slopes[..., 1] += g * ay
            if with_shape:
                slopes[..., 2] += 0.5 * g * (ax * ax - pxx)
                slopes[..., 3] += 0.5 * g * (ay * ay - pyy)
                slopes[..., 4] += g * (ax * ay - pxy)
    return total, slopes


def fit_gaussians(signal_dn: np.ndarray, floor_variance_dn2: np.ndarray, unusable: np.ndarray, xy_px: np.ndarray,
                  moments_px2: np.ndarray, *, gain_dn_per_e: float, radius: int, free_shape: bool = False,
                  model_error: float = 0.0) -> GaussianFit:
    """Fit every spot in a window of its own.

    Args:
        signal_dn: (H, W) DN above dark. floor_variance_dn2: (H, W), variance of a pixel without the spot's own light.
        unusable: (H, W) bool, given no weight. xy_px: (N, 2) start. moments_px2: (N, 3) shape, or start of it.
        gain_dn_per_e: for the spot's own shot noise; NaN leaves it out. radius: half width of the window, px.
        model_error: relative misfit of the shape, added to the variance as (model_error * model)^2.
    """
    w, h = signal_dn.shape[::-1]
    centre = np.clip(np.rint(xy_px).astype(np.int64), 0, [w - 1, h - 1])
    signal = cut(signal_dn, centre, radius, np.nan)
    signal[cut(unusable, centre, radius, True)] = np.nan
    floor = cut(floor_variance_dn2, centre, radius, 1.0)
    return fit_patches(Patches(signal_dn=signal, floor_variance_dn2=floor, corner_xy=centre - radius), xy_px, moments_px2,
                       gain_dn_per_e=gain_dn_per_e, free_shape=free_shape, model_error=model_error)


def fit_patches(patches: Patches, xy_px: np.ndarray, moments_px2: np.ndarray, *, gain_dn_per_e: float,
                free_shape: bool = False, model_error: float = 0.0) -> GaussianFit:
    """`fit_gaussians` on windows that are cut out already."""
    n, side = patches.signal_dn.shape[:2]
    offset = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    pixels = (patches.corner_xy[:, None] + offset).astype(float)
    data, floor = (a.reshape(n, side * side).astype(float) for a in (patches.signal_dn, patches.floor_variance_dn2))
    bad = ~np.isfinite(data)
    data, floor = np.where(bad, 0.0, data), np.where(bad, 1.0, floor)
    shot = gain_dn_per_e if np.isfinite(gain_dn_per_e) else 0.0
    xy, s = np.array(xy_px, float), np.array(moments_px2, float)
    count = np.maximum((~bad).sum(1), 1)
    background = np.array([np.median(row[~mask]) if (~mask).any() else 0.0 for row, mask in zip(data, bad, strict=True)])
    flux = np.maximum((np.where(bad, 0, data - background[:, None])).sum(1), 1.0)
    p = 7 if free_shape else 4
    step_xy = np.full(n, np.inf)
    identity = np.eye(p)
    normal = np.broadcast_to(identity, (n, p, p))
    residual = weight = np.zeros_like(data)
    for _ in range(STEPS):
        unit, slopes = _model(xy, pixels, s, free_shape)
        light = np.maximum(flux[:, None] * unit, 0)
        weight = np.where(bad, 0.0, 1 / (floor + shot * light + (model_error * light) ** 2))
        jacobian = np.concatenate([flux[:, None, None] * slopes[..., :2], unit[..., None], np.ones_like(unit)[..., None],
                                   flux[:, None, None] * slopes[..., 2:]], -1)
        residual = data - background[:, None] - flux[:, None] * unit
        weighted = jacobian * weight[..., None]
        normal = np.swapaxes(weighted, 1, 2) @ jacobian
        scale = np.sqrt(np.maximum(np.einsum("npp->np", normal), 1e-30))
        conditioned = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * identity
        step = np.linalg.solve(conditioned, (np.einsum("nmp,nm->np", weighted, residual) / scale)[..., None])[..., 0] / scale
        length = np.hypot(step[:, 0], step[:, 1])
        step *= np.minimum(1, LARGEST_STEP_PX / np.maximum(length, 1e-12))[:, None]
        xy, flux, background = xy + step[:, :2], flux + step[:, 2], background + step[:, 3]
        if free_shape:
            s = np.clip(s + step[:, 4:], np.stack([s[:, 0] / 2, s[:, 1] / 2, -np.full(n, np.inf)], -1),
                        np.stack([s[:, 0] * 2, s[:, 1] * 2, np.full(n, np.inf)], -1))
            limit = 0.9 * np.sqrt(s[:, 0] * s[:, 1])
            s[:, 2] = np.clip(s[:, 2], -limit, limit)
        step_xy = np.hypot(step[:, 0], step[:, 1])
        if np.all(step_xy < CONVERGED_PX):
            break
    inverse = np.linalg.inv(conditioned) / (scale[:, :, None] * scale[:, None, :])
    chi2 = (residual**2 * weight).sum(1) / np.maximum(count - p, 1)
    wandered = np.max(np.abs(xy - xy_px), axis=1, initial=0) > side // 2
    converged = (step_xy < 0.02) & (flux > 0) & ~wandered & (count > p) & np.isfinite(xy).all(1)
    return GaussianFit(xy_px=xy, flux_dn=flux, background_dn=background, moments_px2=s, covariance=inverse, chi2_per_dof=chi2,
                       converged=converged)
