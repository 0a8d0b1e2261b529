"""find_spots: from a corrected frame to its spots, brightest first.

1. Background and noise, locally; the detection threshold from the asked number of false alarms.
2. Detection by the named detector on what is left above the background.
3. Centroids by the named centroider, with covariance.
4. Flags; a spot whose fit failed keeps its rough place and says so.
"""

from __future__ import annotations

import numpy as np

from .. import registry
from ..records import DEFECT_FLAGS, UNUSABLE, CorrectedFrame, PsfMap, Spots
from .background import background_and_noise, busy_area
from .cut import cut
from .false_alarms import NoiseLaw, step_from_skewness
from .flags import flag
from .psf import moments_at
from .scene import Scene

MOST_SPOTS = 500  # the brightest; a frame with more is full of something else than stars
FALSE_ALARMS = 1.0  # a frame, asked for unless the caller says otherwise
ROUGH_SD_PX = 0.5


def find_spots(corrected: CorrectedFrame, psf: PsfMap, *, psf_known: bool = False, detector: str = "scan",
               centroider: str = "psf_map", k_sigma: float | None = None, false_alarms: float = FALSE_ALARMS) -> Spots:
    """Spots of a frame; `psf_known` says whether the map's PSF was measured.

    k_sigma: detection threshold; None: the one at which noise alone gives `false_alarms` spots a frame, where the detector can
    tell it.

    Raises:
        UsageError: unknown detector or centroider.
    """
    finder = registry.load("calibench.spots.detect", detector)
    saturated = (corrected.defects & DEFECT_FLAGS["saturated"]) != 0
    broken = (corrected.defects & (UNUSABLE & ~DEFECT_FLAGS["saturated"])) != 0
    broken |= ~np.isfinite(corrected.signal_dn)
    background, noise = background_and_noise(corrected.signal_dn, broken | saturated)
    signal = np.where(broken, np.float32(0), corrected.signal_dn - background).astype(np.float32)
    floor = _floor_variance(corrected, signal, noise)
    if k_sigma is None:
        k_sigma = finder.threshold(noise, broken, false_alarms, _noise_law(corrected, signal, noise, broken | saturated))
    candidates = finder.detect(signal, noise, broken, k_sigma)
    busy = busy_area(noise)[candidates.peak_xy[:, 1], candidates.peak_xy[:, 0]]
    order = np.lexsort((-candidates.flux_dn, busy))[:MOST_SPOTS]
    candidates, busy = candidates.take(order), busy[order]
    scene = Scene(signal_dn=signal, floor_variance_dn2=floor, unusable=broken | saturated,
                  gain_dn_per_e=corrected.gain_dn_per_e, psf=psf, psf_known=psf_known)
    found = registry.load("calibench.spots.centroid", centroider).centroid(scene, candidates)
    peak = np.ascontiguousarray(candidates.peak_xy, np.int64)
    flags = flag(candidates, found, signal=cut(signal, peak, 1, np.float32(0)), noise_dn=noise[peak[:, 1], peak[:, 0]],
                 saturated=cut(saturated, peak, 1, False), broken=cut(broken, peak, 1, False),
                 image_size_px=signal.shape[::-1], moments_px2=moments_at(psf, candidates.xy_px) if psf_known else None,
                 gain_dn_per_e=corrected.gain_dn_per_e)
    ok, gain = found.ok, corrected.gain_dn_per_e if np.isfinite(corrected.gain_dn_per_e) else 1.0
    xy = np.where(ok[:, None], found.xy_px, candidates.xy_px)
    flux = np.where(ok, found.flux_dn, candidates.flux_dn)
    spots = Spots(xy_px=xy, covariance_px2=np.where(ok[:, None, None], found.covariance_px2, np.eye(2) * ROUGH_SD_PX**2),
                  flux_e=flux / gain, background_dn=background[peak[:, 1], peak[:, 0]] + np.where(ok, found.background_dn, 0.0),
                  peak_dn=candidates.peak_dn, pixels=candidates.pixels, flags=flags)
    w, h = signal.shape[::-1]
    inside = (xy > -0.5).all(1) & (xy < [w - 0.5, h - 0.5]).all(1) & (flux > 0)
    # A spot in a restless area is put after all quiet ones: it is kept, but a star is looked for elsewhere first.
    rank = np.lexsort((-flux, busy))
    return spots.take(rank[inside[rank]])


def _floor_variance(corrected: CorrectedFrame, signal: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Variance (H, W) of each pixel without the light above the background, never below what the frame itself shows.

    `variance_dn2` holds the shot noise of all the light, the stars' too; a fit adds the star's own from its model."""
    shown = noise**2
    if not np.isfinite(corrected.gain_dn_per_e):
        return np.fmax(corrected.variance_dn2, shown).astype(np.float32)  # NaN where the read noise is not known
    return np.fmax(corrected.variance_dn2 - np.float32(corrected.gain_dn_per_e) * signal, shown).astype(np.float32)


def _noise_law(corrected: CorrectedFrame, signal: np.ndarray, noise: np.ndarray,
               unusable: np.ndarray) -> NoiseLaw:
    """Which part of the noise comes in steps of an electron: from gain and read noise, else from the frame's skewness."""
    sample = np.s_[::4, ::4]
    some = corrected.signal_dn[sample][~unusable[sample]]
    whole = bool(some.size) and bool((some == np.rint(some)).all())
    if np.isfinite(corrected.gain_dn_per_e) and np.isfinite(corrected.variance_dn2[sample]).any():
        normal2 = np.nanmedian(corrected.variance_dn2[sample] - corrected.gain_dn_per_e * corrected.signal_dn[sample])
        return NoiseLaw(step_dn=corrected.gain_dn_per_e, normal_dn=float(np.sqrt(max(normal2, 0.0))), whole_dn=whole)
    return NoiseLaw(step_dn=step_from_skewness(signal, noise, unusable), whole_dn=whole)
