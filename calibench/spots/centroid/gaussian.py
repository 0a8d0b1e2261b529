"""Poisson-weighted Gauss-Newton fit of a pixel-integrated Gaussian whose shape comes from the PSF map.

Without a measured PSF the shape is the median of free fits to the frame's own brightest unsaturated spots.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..gaussian_fit import fit_gaussians, windows
from ..psf import moments_at
from ..scene import Centroids, Scene

SHAPE_SPOTS = 30
MODEL_ERROR_KNOWN, MODEL_ERROR_GUESSED = 0.01, 0.05  # relative misfit of the shape: the PSF map's, a frame median's


def shape_from_frame(scene: Scene, candidates: Candidates) -> np.ndarray:
    """Median moments (3,) of free fits to the brightest usable candidates; one pixel wide if there are none."""
    lost, _ = windows(scene.unusable, candidates.peak_xy, 2)
    rows = np.flatnonzero(~lost.any(1) & (candidates.elongation < 2))
    rows = rows[np.argsort(-candidates.flux_dn[rows])][:SHAPE_SPOTS]
    if len(rows) == 0:
        return np.array([1.0, 1.0, 0.0])
    start = np.tile([1.0, 1.0, 0.0], (len(rows), 1))
    fit = fit_gaussians(scene.signal_dn, scene.floor_variance_dn2, scene.unusable, candidates.peak_xy[rows].astype(float),
                        start, gain_dn_per_e=scene.gain_dn_per_e, radius=4, free_shape=True, model_error=MODEL_ERROR_GUESSED)
    good = fit.moments_px2[fit.converged & (fit.moments_px2[:, :2].min(1) < 9)]
    return np.median(good, axis=0) if len(good) else np.array([1.0, 1.0, 0.0])


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, 2x2 covariance (scaled up where the fit is worse than its noise), flux and local background of each spot."""
    if scene.psf_known:
        moments = moments_at(scene.psf, candidates.xy_px)
    else:
        moments = np.tile(shape_from_frame(scene, candidates), (len(candidates), 1))
    width = np.sqrt(np.median(moments[:, :2].max(1))) if len(moments) else 1.0
    radius = int(np.clip(np.ceil(2.5 * width + 0.5), 2, 8))
    fit = fit_gaussians(scene.signal_dn, scene.floor_variance_dn2, scene.unusable, candidates.xy_px, moments,
                        gain_dn_per_e=scene.gain_dn_per_e, radius=radius,
                        model_error=MODEL_ERROR_KNOWN if scene.psf_known else MODEL_ERROR_GUESSED)
    covariance = fit.covariance[:, :2, :2] * np.maximum(fit.chi2_per_dof, 1.0)[:, None, None]
    return Centroids(xy_px=fit.xy_px, covariance_px2=covariance, flux_dn=fit.flux_dn, background_dn=fit.background_dn,
                     ok=fit.converged)
