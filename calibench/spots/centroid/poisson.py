"""The fast default: Poisson-weighted Gauss-Newton fit of a Gaussian of known shape, compiled; at the photon limit for it.

Position, flux and background are free, the shape is the PSF map's; without a measured one it is the median of the frame's own
brightest spots. Weights are 1/variance with the variance from the model, which reaches the Cramer-Rao bound.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..cut import cut
from ..fit.known_shape import LOST_CORE_ERROR, fit_windows, window_radius
from ..frame_shape import GUESSED_SHAPE_ERROR, shape_from_frame
from ..kernels import lose_others
from ..psf import moments_at
from ..scene import Centroids, Scene


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, covariance (scaled up where the fit is clearly worse than its noise), flux and local background."""
    moments = moments_at(scene.psf, candidates.xy_px) if scene.psf_known else np.tile(
        shape_from_frame(scene, candidates), (len(candidates), 1))
    radius = window_radius(moments)
    centre = np.rint(candidates.xy_px).astype(np.int64)
    signal = cut(scene.signal_dn, centre, radius, np.float32(np.nan))
    floor = cut(scene.floor_variance_dn2, centre, radius, np.float32(1))
    lost = cut(scene.unusable, centre, radius, True)
    core_lost = lost[:, radius - 1:radius + 2, radius - 1:radius + 2].any((1, 2))
    error = np.maximum(core_lost * LOST_CORE_ERROR, 0.0 if scene.psf_known else GUESSED_SHAPE_ERROR)
    lose_others(np.ascontiguousarray(candidates.xy_px, float), centre - radius, lost)
    return fit_windows(np.where(lost, np.float32(np.nan), signal), floor, centre - radius, candidates.xy_px, moments,
                       gain_dn_per_e=scene.gain_dn_per_e, model_error=error)
