"""The PSF's shape at the candidates: the map's, or, where nobody measured it, what the frame's own brightest spots show."""

from __future__ import annotations

import numpy as np

from .candidates import Candidates
from .gaussian_fit import fit_patches
from .psf import moments_at
from .scene import Scene

SHAPE_SPOTS = 30
SHAPE_RADIUS_PX = 4
WIDEST_PX2 = 9.0
GUESSED_SHAPE_ERROR = 0.05  # relative misfit of a shape that is the median of a frame's
ROUND = np.array([1.0, 1.0, 0.0])


def moments_of(scene: Scene, candidates: Candidates) -> np.ndarray:
    """Second moments (N, 3), px^2, of the light at each candidate, pixel not included."""
    if scene.psf_known:
        return moments_at(scene.psf, candidates.xy_px)
    shape = shape_from_frame(scene, candidates) if scene.shape_px2 is None else scene.shape_px2
    return np.tile(shape, (len(candidates), 1))


def shape_from_frame(scene: Scene, candidates: Candidates) -> np.ndarray:
    """Median moments (3,) of free fits to the brightest usable candidates; one pixel wide if there are none."""
    patches = scene.patches(np.ascontiguousarray(candidates.peak_xy, np.int64), SHAPE_RADIUS_PX)
    lost = np.isnan(patches.signal_dn[:, 2:-2, 2:-2]).any((1, 2))
    rows = np.flatnonzero(~lost & (candidates.elongation < 2) & ~candidates.blend)
    rows = rows[np.argsort(-candidates.flux_dn[rows])][:SHAPE_SPOTS]
    if len(rows) == 0:
        return ROUND
    fit = fit_patches(patches.take(rows), candidates.peak_xy[rows].astype(float), np.tile(ROUND, (len(rows), 1)),
                      gain_dn_per_e=scene.gain_dn_per_e, free_shape=True, model_error=GUESSED_SHAPE_ERROR)
    good = fit.moments_px2[fit.converged & (fit.moments_px2[:, :2].min(1) < WIDEST_PX2)]
    return np.median(good, axis=0) if len(good) else ROUND
