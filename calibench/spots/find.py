"""find_spots: from a corrected frame to its spots, brightest first.

1. Background and noise, locally.
2. Detection by the named detector on what is left above the background.
3. Centroids by the named centroider, with covariance.
4. Flags; a spot whose fit failed keeps its rough place and says so.
"""

from __future__ import annotations

import numpy as np

from .. import registry
from ..records import DEFECT_FLAGS, SPOT_FLAGS, UNUSABLE, CorrectedFrame, PsfMap, Spots
from .background import background_and_noise, busy_area
from .gaussian_fit import windows
from .scene import Scene

MOST_SPOTS = 500  # the brightest; a frame with more is full of something else than stars
ROUGH_SD_PX = 0.5
TRAIL_ELONGATION = 3.0


def find_spots(corrected: CorrectedFrame, psf: PsfMap, *, psf_known: bool = False, detector: str = "components",
               centroider: str = "gaussian", k_sigma: float = 5.0) -> Spots:
    """Spots of a frame; `psf_known` says whether the map's PSF was measured.

    Raises:
        UsageError: unknown detector or centroider.
    """
    saturated = (corrected.defects & DEFECT_FLAGS["saturated"]) != 0
    broken = (corrected.defects & (UNUSABLE & ~DEFECT_FLAGS["saturated"])) != 0
    broken |= ~np.isfinite(corrected.signal_dn)
    background, noise = background_and_noise(corrected.signal_dn, broken | saturated)
    signal = np.where(broken, 0.0, corrected.signal_dn - background).astype(np.float32)
    detect = registry.load("calibench.spots.detect", detector).detect
    candidates = detect(signal, noise, broken, k_sigma)
    busy = busy_area(noise)[candidates.peak_xy[:, 1], candidates.peak_xy[:, 0]]
    order = np.lexsort((-candidates.flux_dn, busy))[:MOST_SPOTS]
    candidates, busy = candidates.take(order), busy[order]
    measured = np.isfinite(corrected.variance_dn2)
    floor = np.maximum(np.where(measured, corrected.variance_dn2, 0.0), noise**2)
    scene = Scene(signal_dn=signal, floor_variance_dn2=floor, unusable=broken | saturated,
                  gain_dn_per_e=corrected.gain_dn_per_e, psf=psf, psf_known=psf_known)
    found = registry.load("calibench.spots.centroid", centroider).centroid(scene, candidates)
    xy = np.where(found.ok[:, None], found.xy_px, candidates.xy_px)
    covariance = np.where(found.ok[:, None, None], found.covariance_px2, np.eye(2) * ROUGH_SD_PX**2)
    flux = np.where(found.ok, found.flux_dn, candidates.flux_dn)
    flags = _flags(candidates, found.ok, saturated, broken)
    gain = corrected.gain_dn_per_e if np.isfinite(corrected.gain_dn_per_e) else 1.0
    spots = Spots(xy_px=xy, covariance_px2=covariance, flux_e=flux / gain,
                  background_dn=background[candidates.peak_xy[:, 1], candidates.peak_xy[:, 0]] + found.background_dn,
                  peak_dn=candidates.peak_dn, pixels=candidates.pixels, flags=flags)
    w, h = corrected.signal_dn.shape[::-1]
    inside = (xy > -0.5).all(1) & (xy < [w - 0.5, h - 0.5]).all(1) & (flux > 0)
    # A spot in a restless area is put after all quiet ones: it is kept, but a star is looked for elsewhere first.
    rank = np.lexsort((-flux, busy))
    return spots.take(rank[inside[rank]])


def _flags(candidates, ok: np.ndarray, saturated: np.ndarray, broken: np.ndarray) -> np.ndarray:
    h, w = saturated.shape
    near_saturated, _ = windows(saturated, candidates.peak_xy, 1)
    near_broken, _ = windows(broken, candidates.peak_xy, 1)
    x, y = candidates.peak_xy.T
    edge = (x < 2) | (y < 2) | (x > w - 3) | (y > h - 3)
    inner = ~edge[:, None]
    conditions = {"saturated": (near_saturated & inner).any(1), "defect": (near_broken & inner).any(1), "edge": edge,
                  "trail": candidates.elongation > TRAIL_ELONGATION, "fit_failed": ~ok}
    return np.sum([SPOT_FLAGS[name] * on for name, on in conditions.items()], axis=0).astype(np.uint16)
