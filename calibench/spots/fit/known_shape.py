"""Windows fitted by a Gaussian of known shape: position, covariance, flux and background of each."""

from __future__ import annotations

import math

import numpy as np

from ..scene import Centroids
from .kernels import LARGEST_ORDER, fit_known_shape

SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 2, 8


def window_radius(moments_px2: np.ndarray) -> int:
    """Half width of the window for spots of these moments (N, 3): 5x5 for 0.4 px, 7x7 for 0.7 and 1.0, 9x9 for 1.5."""
    width = math.sqrt(moments_px2[:, :2].max(1).sum() / len(moments_px2)) if len(moments_px2) else 1.0
    return min(max(math.ceil(2.3 * width + 0.5), SMALLEST_RADIUS_PX), LARGEST_RADIUS_PX)


def fit_windows(signal_dn: np.ndarray, floor_variance_dn2: np.ndarray, corner_xy: np.ndarray, start_xy_px: np.ndarray,
                moments_px2: np.ndarray, *, gain_dn_per_e: float, model_error: np.ndarray | float) -> Centroids:
    """Poisson-weighted Gauss-Newton fit of every window.

    Args:
        signal_dn: (N, n, n), NaN where a pixel is not used. floor_variance_dn2: (N, n, n), of a pixel without the spot's own
        light. corner_xy: (N, 2), where pixel [0, 0] of a window stands in the frame. start_xy_px: (N, 2) in the frame.
        moments_px2: (N, 3), s_xx s_yy s_xy before the pixel integrates. gain_dn_per_e: NaN leaves the spot's shot noise out.
        model_error: relative misfit of the shape (0: believed to the photon).
    """
    n, side = len(signal_dn), signal_dn.shape[-1]
    gain = float(gain_dn_per_e) if np.isfinite(gain_dn_per_e) else 0.0
    error = np.empty(n)
    error[:] = model_error
    found = np.empty((n, 9))
    fit_known_shape(np.ascontiguousarray(signal_dn, np.float32), np.ascontiguousarray(floor_variance_dn2, np.float32),
                    np.ascontiguousarray(start_xy_px - corner_xy, float), np.ascontiguousarray(moments_px2, float), gain, error,
                    np.empty((2, LARGEST_ORDER + 2, side)), np.empty((6, side * side)), np.zeros((4, 4, 5)), found)
    return Centroids(xy_px=found[:, :2] + corner_xy, covariance_px2=found[:, 4:8].reshape(n, 2, 2), flux_dn=found[:, 2],
                     background_dn=found[:, 3], ok=found[:, 8] > 0)
