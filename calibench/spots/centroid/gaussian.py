"""Fit of a pixel-integrated Gaussian whose shape is free: for spots of which each may look different, and the light to tell it.

Poisson-weighted Gauss-Newton over position, flux, background and three second moments (spots/gaussian_fit.py). It starts from
the PSF map's shape, or from the median of the frame's own brightest spots.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..fit.known_shape import window_radius
from ..frame_shape import moments_of
from ..gaussian_fit import fit_patches
from ..scene import Centroids, Scene


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, covariance (scaled up where the fit is worse than its noise), flux and local background of each spot."""
    start = moments_of(scene, candidates)
    patches = scene.patches(np.rint(candidates.xy_px).astype(np.int64), window_radius(start))
    fit = fit_patches(patches, candidates.xy_px, start, gain_dn_per_e=scene.gain_dn_per_e, free_shape=True)
    covariance = fit.covariance[:, :2, :2] * np.maximum(fit.chi2_per_dof, 1.0)[:, None, None]
    return Centroids(xy_px=fit.xy_px, covariance_px2=covariance, flux_dn=fit.flux_dn, background_dn=fit.background_dn,
                     ok=fit.converged)
