"""Fit of a pixel-integrated Gaussian whose shape is free: for spots of which each may look different, and the light to tell it.

Poisson-weighted Gauss-Newton over position, flux, background and three second moments (spots/gaussian_fit.py). It starts from
the PSF map's shape, or from the median of the frame's own brightest spots.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..fit.known_shape import window_radius
from ..frame_shape import shape_from_frame
from ..gaussian_fit import fit_gaussians
from ..psf import moments_at
from ..scene import Centroids, Scene


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, covariance (scaled up where the fit is worse than its noise), flux and local background of each spot."""
    start = moments_at(scene.psf, candidates.xy_px) if scene.psf_known else np.tile(
        shape_from_frame(scene, candidates), (len(candidates), 1))
    fit = fit_gaussians(scene.signal_dn, scene.floor_variance_dn2, scene.unusable, candidates.xy_px, start,
                        gain_dn_per_e=scene.gain_dn_per_e, radius=window_radius(start), free_shape=True)
    covariance = fit.covariance[:, :2, :2] * np.maximum(fit.chi2_per_dof, 1.0)[:, None, None]
    return Centroids(xy_px=fit.xy_px, covariance_px2=covariance, flux_dn=fit.flux_dn, background_dn=fit.background_dn,
                     ok=fit.converged)
