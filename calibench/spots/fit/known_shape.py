"""Windows fitted by a Gaussian of known shape: position, covariance, flux and background of each."""

from __future__ import annotations

import numpy as np

from ..scene import Centroids
from .kernels import fit_known_shape

SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 2, 8
# A misfit is believed, and the covariance scaled up by it, where chi^2 is beyond its expectation by this many sigma: noise
# alone must not widen the error bars.
MISFIT_SIGMA = 3.0
LOST_CORE_ERROR = 0.1  # relative: how well the wings of a PSF are known, which alone are left of a saturated spot


def window_radius(moments_px2: np.ndarray) -> int:
    """Half width of the window for spots of these moments (N, 3): 5x5 for 0.4 px, 7x7 for 0.7 and 1.0, 9x9 for 1.5."""
    width = np.sqrt(np.median(np.max(moments_px2[:, :2], axis=1))) if len(moments_px2) else 1.0
    return int(np.clip(np.ceil(2.3 * width + 0.5), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX))


def fit_windows(signal_dn: np.ndarray, floor_variance_dn2: np.ndarray, corner_xy: np.ndarray, start_xy_px: np.ndarray,
                moments_px2: np.ndarray, *, gain_dn_per_e: float, model_error: np.ndarray | float) -> Centroids:
    """Poisson-weighted Gauss-Newton fit of every window.

    Args:
        signal_dn: (N, n, n), NaN where a pixel is not used. floor_variance_dn2: (N, n, n), of a pixel without the spot's own
        light. corner_xy: (N, 2), where pixel [0, 0] of a window stands in the frame. start_xy_px: (N, 2) in the frame.
        moments_px2: (N, 3), s_xx s_yy s_xy before the pixel integrates. gain_dn_per_e: NaN leaves the spot's shot noise out.
        model_error: relative misfit of the shape (0: believed to the photon).
    """
    n = len(signal_dn)
    error = np.broadcast_to(np.asarray(model_error, float), n).copy()
    gain = float(gain_dn_per_e) if np.isfinite(gain_dn_per_e) else 0.0
    found = fit_known_shape(np.ascontiguousarray(signal_dn, np.float32), np.ascontiguousarray(floor_variance_dn2, np.float32),
                            np.ascontiguousarray(start_xy_px - corner_xy, float), np.ascontiguousarray(moments_px2, float),
                            gain, error)
    freedom = np.maximum(np.isfinite(signal_dn).sum((1, 2)) - 4, 1)
    misfit = np.where(found[:, 8] > 1 + MISFIT_SIGMA * np.sqrt(2 / freedom), found[:, 8], 1.0)
    covariance = found[:, [4, 5, 5, 6]].reshape(n, 2, 2) * misfit[:, None, None]
    return Centroids(xy_px=found[:, :2] + corner_xy, covariance_px2=covariance, flux_dn=found[:, 2], background_dn=found[:, 3],
                     ok=found[:, 9] > 0)
