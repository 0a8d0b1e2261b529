"""Poisson-weighted fit of the map's own PSF: the centroid that neither coma nor magnitude moves.

The position is the centre of mass of the light as the map holds it, at any flux. Where the map knows no more than a Gaussian
(or nothing), this is the `poisson` centroider.
"""

from __future__ import annotations

import numpy as np

from ...records import HermiteShape
from .. import hermite
from ..candidates import Candidates
from ..scene import Centroids, Scene
from . import poisson
from ._known_shape import own_patches
from .kernels import fit_shapes

SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 2, 7
RADIUS_SIGMAS, PIXEL_VARIANCE_PX2 = 3.3, 1 / 12
SIGNIFICANT = 5.0  # chi2/dof beyond its own scatter by this many sigma widens the covariance; less is chance


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position, 2x2 covariance (wider where the fit is significantly worse than its noise), flux and local background."""
    if not scene.psf_known or scene.psf.hermite is None:
        return poisson.centroid(scene, candidates)
    shape = scene.psf.hermite
    radius = window_radius(shape)
    core, wings = matrices(shape, hermite.coefficients_at(shape, candidates.xy_px, scene.psf.image_size_px))
    patches, misfit = own_patches(scene, candidates, radius + 1)
    found = fit_shapes(patches.signal_dn, patches.floor_variance_dn2, np.ascontiguousarray(
        candidates.xy_px - patches.corner_xy, float), core, wings, shape.scale_px, hermite.WING_FACTOR * shape.scale_px,
                       float(np.nan_to_num(scene.gain_dn_per_e)), np.maximum(misfit, shape.core_residual), radius)
    found[:, :2] += patches.corner_xy
    x, y, flux, background, xx, yy, xy, chi2, pixels = found.T
    scatter = np.sqrt(2 / np.maximum(pixels - 4, 1))
    wider = np.where(chi2 > 1 + SIGNIFICANT * scatter, chi2, 1.0)
    return Centroids(xy_px=np.stack([x, y], -1), covariance_px2=np.stack([xx, xy, xy, yy], -1).reshape(-1, 2, 2)
                     * wider[:, None, None], flux_dn=flux, background_dn=background, ok=np.isfinite(x))


def window_radius(shape: HermiteShape) -> int:
    """Half width of the window: what holds the light's slopes, and no more of the background than that."""
    return int(np.clip(np.rint(RADIUS_SIGMAS * np.sqrt(shape.scale_px**2 + PIXEL_VARIANCE_PX2)), SMALLEST_RADIUS_PX,
                       min(LARGEST_RADIUS_PX, shape.radius_px)))


def matrices(shape: HermiteShape, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (N, K) as core (N, P, P) and wings (N, 3, 3), [order along y, order along x]."""
    out, first = [], 0
    for order in (shape.order, hermite.WING_ORDER):
        pairs = hermite.exponents(order)
        matrix = np.zeros((len(coefficients), order + 1, order + 1))
        matrix[:, pairs[:, 1], pairs[:, 0]] = coefficients[:, first:first + len(pairs)]
        out.append(matrix)
        first += len(pairs)
    return out[0], out[1]
