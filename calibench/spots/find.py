"""find_spots: from a corrected frame to its spots, brightest first.

1. Background and noise, locally; the detection threshold from the asked number of false alarms.
2. Detection by the named detector on what is left above the background.
3. Centroids by the named centroider, with covariance; flags (spots/measured.py).
"""

from __future__ import annotations

import numpy as np

from .. import registry
from ..records import DEFECT_FLAGS, UNUSABLE, CorrectedFrame, PsfMap, Spots
from .background import background_and_noise, busy_area
from .cut import cut
from .false_alarms import FALSE_ALARMS, NoiseLaw, Sensitivity, step_from_skewness
from .flags import Near
from .measured import brightest, measured
from .scene import NAN, FrameScene


def find_spots(corrected: CorrectedFrame, psf: PsfMap, *, psf_known: bool = False, detector: str = "scan",
               centroider: str = "psf_map", k_sigma: float | None = None, false_alarms: float = FALSE_ALARMS) -> Spots:
    """Spots of a frame; `psf_known` says whether the map's PSF was measured.

    k_sigma: detection threshold; None: the one at which noise alone gives `false_alarms` spots a frame, where the detector can
    tell it.

    Raises:
        UsageError: unknown detector or centroider.
    """
    finder = registry.load("calibench.spots.detect", detector)
    unusable = ((corrected.defects & UNUSABLE) != 0) | ~np.isfinite(corrected.signal_dn)
    broken = ((corrected.defects & (UNUSABLE & ~DEFECT_FLAGS["saturated"])) != 0) | ~np.isfinite(corrected.signal_dn)
    background, noise = background_and_noise(corrected.signal_dn, unusable)
    signal = np.where(broken, np.float32(0), corrected.signal_dn - background).astype(np.float32)
    sensitivity = Sensitivity(k_sigma=k_sigma, false_alarms=false_alarms, law=_noise_law(corrected, signal, noise, unusable))
    candidates, restless = brightest(finder.detect(signal, noise, broken, sensitivity), busy_area(noise))
    scene = FrameScene(signal_dn=signal, floor_variance_dn2=_floor_variance(corrected, signal, noise), unusable=unusable,
                       gain_dn_per_e=corrected.gain_dn_per_e, psf=psf, psf_known=psf_known)
    peak = np.ascontiguousarray(candidates.peak_xy, np.int64)
    x, y = peak.T
    near = Near(signal_dn=cut(np.where(broken, NAN, signal), peak, 1, NAN), defects=cut(corrected.defects, peak, 1, 0),
                noise_dn=noise[y, x], background_dn=background[y, x])
    return measured(scene, candidates, restless, near, centroider=centroider, image_size_px=signal.shape[::-1])


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
