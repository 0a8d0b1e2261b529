"""Scene: one frame made ready for centroids. Centroids: what comes back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..records import PsfMap


@dataclass(frozen=True, kw_only=True)
class Scene:
    """signal_dn (H, W): above background. floor_variance_dn2 (H, W): of a pixel without stars. unusable (H, W) bool.
    psf: the PSF map; psf_known False: its shape is a guess and the frame's own stars must tell it."""

    signal_dn: np.ndarray
    floor_variance_dn2: np.ndarray
    unusable: np.ndarray
    gain_dn_per_e: float
    psf: PsfMap
    psf_known: bool


@dataclass(frozen=True, kw_only=True)
class Centroids:
    """xy_px (N, 2), covariance_px2 (N, 2, 2), flux_dn (N,), background_dn (N,) left over, ok (N,) bool."""

    xy_px: np.ndarray
    covariance_px2: np.ndarray
    flux_dn: np.ndarray
    background_dn: np.ndarray
    ok: np.ndarray
