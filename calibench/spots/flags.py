"""What is wrong with a spot: SPOT_FLAGS of candidates and their centroids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .candidates import Candidates
from .kernels import flag_spots
from .scene import Centroids

NOT_KNOWN = np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True)
class Near:
    """What stands about each peak. signal_dn (N, 3, 3) float32 above the background, NaN beyond the frame's edge and where it
    is not finite; defects (N, 3, 3) uint16 of DEFECT_FLAGS; noise_dn, background_dn (N,) of one pixel there."""

    signal_dn: np.ndarray
    defects: np.ndarray
    noise_dn: np.ndarray
    background_dn: np.ndarray


def flag(candidates: Candidates, found: Centroids, near: Near, *, image_size_px: tuple[int, int],
         moments_px2: np.ndarray | None, gain_dn_per_e: float) -> np.ndarray:
    """Flags (N,) uint16.

    moments_px2: (N, 3) of the measured PSF, or None. `edge`: within 2 px of the image's edge. `blend`: light connected with
    another spot's, or another spot in the same window. `trail`: three times as long as wide. `cosmic`: the peak pixel holds
    more of its 3x3's light than the PSF gives it, at any place within the pixel. `defect`: an unusable pixel in the 3x3.
    """
    flags = np.zeros(len(candidates), np.uint16)
    w, h = image_size_px
    flag_spots(np.ascontiguousarray(candidates.xy_px, float), np.ascontiguousarray(candidates.peak_xy, np.int64), found.ok,
               candidates.blend, np.ascontiguousarray(candidates.elongation, float), near.signal_dn, near.defects,
               np.ascontiguousarray(near.noise_dn, np.float32), np.ascontiguousarray(found.background_dn, float), w, h,
               NOT_KNOWN if moments_px2 is None else moments_px2, gain_dn_per_e if gain_dn_per_e == gain_dn_per_e else 0.0,
               flags)
    return flags
