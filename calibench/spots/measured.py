"""measured: from candidates of a scene to its spots, brightest first: centroids by the named centroider, flags, order.

A spot whose fit failed keeps its rough place and says so. A spot in a restless area (branches, a roof) is put after all quiet
ones: it is kept, but a star is looked for elsewhere first.
"""

from __future__ import annotations

import numpy as np

from .. import registry
from ..records import Spots
from .candidates import Candidates
from .flags import Near, flag
from .psf import moments_at
from .scene import Centroids, Scene

MOST_SPOTS = 500  # the brightest; a frame with more is full of something else than stars
ROUGH_COVARIANCE_PX2 = np.eye(2) * 0.5**2


def brightest(candidates: Candidates, busy: np.ndarray | None) -> tuple[Candidates, np.ndarray]:
    """At most MOST_SPOTS candidates, the quiet ones first, and whether each is in a restless area; busy: (H, W) bool, None
    where nothing is restless."""
    if busy is None:
        restless = np.zeros(len(candidates), bool)
    else:
        restless = busy[candidates.peak_xy[:, 1], candidates.peak_xy[:, 0]]
    if len(candidates) <= MOST_SPOTS:
        return candidates, restless
    order = np.lexsort((-candidates.flux_dn, restless))[:MOST_SPOTS]
    return candidates.take(order), restless[order]


def measured(scene: Scene, candidates: Candidates, restless: np.ndarray, near: Near, *, centroider: str,
             image_size_px: tuple[int, int]) -> Spots:
    """Spots at candidates; restless (N,) bool.

    Raises:
        UsageError: unknown centroider.
    """
    module = registry.load("calibench.spots.centroid", centroider)
    if len(candidates) == 0:
        return Spots.none()
    found = module.centroid(scene, candidates)
    flags = flag(candidates, found, near, image_size_px=image_size_px, gain_dn_per_e=scene.gain_dn_per_e,
                 moments_px2=moments_at(scene.psf, candidates.xy_px) if scene.psf_known else None)
    if not found.ok.all():
        bad = ~found.ok
        n = int(bad.sum())
        found = found.with_rows(bad, Centroids(
            xy_px=candidates.xy_px[bad], covariance_px2=np.tile(ROUGH_COVARIANCE_PX2, (n, 1, 1)),
            flux_dn=candidates.flux_dn[bad], background_dn=np.zeros(n), ok=np.zeros(n, bool)))
    xy, flux = found.xy_px, found.flux_dn
    w, h = image_size_px
    inside = (xy > -0.5).all(1) & (xy < (w - 0.5, h - 0.5)).all(1) & (flux > 0)
    order = np.lexsort((-flux, restless))
    order = order[inside[order]]
    gain = scene.gain_dn_per_e if np.isfinite(scene.gain_dn_per_e) else 1.0
    return Spots(xy_px=xy[order], covariance_px2=found.covariance_px2[order], flux_e=flux[order] / gain,
                 background_dn=(near.background_dn + found.background_dn)[order], peak_dn=candidates.peak_dn[order],
                 pixels=candidates.pixels[order], flags=flags[order])
