"""What is wrong with a spot: SPOT_FLAGS of candidates and their centroids."""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from ..records import SPOT_FLAGS, PsfMap
from .candidates import Candidates
from .detect.kernels import TRAIL_ELONGATION
from .kernels import crowded
from .psf import moments_at
from .scene import Centroids

EDGE_PX = 2
BLEND_PX = 4.0  # two spots nearer than this stand in one window
SHARPER_SIGMA = 5.0  # a centre above what the PSF allows by this many sigma ...
SHARPER_BY = 1.15  # ... and by this factor, because the PSF map is not exact


def flag(candidates: Candidates, found: Centroids, *, signal: np.ndarray, noise_dn: np.ndarray, saturated: np.ndarray,
         broken: np.ndarray, image_size_px: tuple[int, int], psf: PsfMap | None, gain_dn_per_e: float) -> np.ndarray:
    """Flags (N,) uint16.

    signal, saturated, broken: (N, 3, 3) about the peak, outside the image 0 and False. noise_dn: (N,) of one pixel there.
    psf: the measured one, or None. `edge`: within 2 px of the image's edge. `blend`: light connected with another spot's,
    or another spot in the same window. `cosmic`: sharper than the PSF allows. `defect`: an unusable pixel in the 3x3.
    """
    w, h = image_size_px
    x, y = candidates.peak_xy.T
    conditions = {
        "saturated": saturated.any((1, 2)),
        "defect": broken.any((1, 2)),
        "edge": (x < EDGE_PX) | (y < EDGE_PX) | (x > w - 1 - EDGE_PX) | (y > h - 1 - EDGE_PX),
        "blend": candidates.blend | crowded(np.ascontiguousarray(candidates.xy_px, float), BLEND_PX),
        "trail": candidates.elongation > TRAIL_ELONGATION,
        "fit_failed": ~found.ok,
        "cosmic": np.zeros(len(x), bool) if psf is None else _sharper(found, candidates, signal, noise_dn, psf, gain_dn_per_e),
    }
    flags = np.zeros(len(x), np.uint16)
    for name, on in conditions.items():
        flags[on] |= SPOT_FLAGS[name]
    return flags


def _sharper(found: Centroids, candidates: Candidates, signal: np.ndarray, noise_dn: np.ndarray, psf: PsfMap,
             gain_dn_per_e: float) -> np.ndarray:
    """Whether the peak pixel holds more of its 3x3's light than the PSF gives it, at any place within the pixel."""
    moments = moments_at(psf, candidates.xy_px)
    inner, outer = (erf(half / np.sqrt(2 * moments[:, :2])) for half in (0.5, 1.5))
    allowed = np.prod(inner / outer, axis=1)
    total = np.maximum(signal.sum((1, 2)), 1e-6)
    shot = (gain_dn_per_e if np.isfinite(gain_dn_per_e) else 0.0) * np.maximum(signal[:, 1, 1], 0)
    sd = np.sqrt(noise_dn**2 * (1 + 8 * allowed**2) + shot * (1 - allowed) ** 2) / total
    part = signal[:, 1, 1] / total
    return (part > SHARPER_BY * allowed) & (part - allowed > SHARPER_SIGMA * sd)
