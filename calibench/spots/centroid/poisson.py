"""The fast default: Poisson-weighted Gauss-Newton fit of a Gaussian of known shape, compiled; at the photon limit for it.

Position, flux and background are free, the shape is the PSF map's; without a measured one it is the median of the frame's own
brightest spots. Weights are 1/variance with the variance from the model, which reaches the Cramer-Rao bound.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..fit.known_shape import fit_windows, window_radius
from ..frame_shape import GUESSED_SHAPE_ERROR, moments_of
from ..scene import Centroids, Scene
from ._known_shape import own_patches


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, covariance (scaled up where the fit is clearly worse than its noise), flux and local background."""
    moments = moments_of(scene, candidates)
    patches, misfit = own_patches(scene, candidates, window_radius(moments))
    if not scene.psf_known:
        misfit = np.maximum(misfit, GUESSED_SHAPE_ERROR)
    return fit_windows(patches.signal_dn, patches.floor_variance_dn2, patches.corner_xy, candidates.xy_px, moments,
                       gain_dn_per_e=scene.gain_dn_per_e, model_error=misfit)
