"""Centre of mass in the 3x3 window about the peak, over the pixels above zero signal (thesis, section 4.3)."""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..gaussian_fit import windows
from ..scene import Centroids, Scene


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Covariance follows from the pixels' variances; the window's cut biases the position by up to 0.25 px (not included)."""
    bad, _ = windows(scene.unusable, candidates.peak_xy, 1)
    data, pixels = windows(scene.signal_dn.astype(float), candidates.peak_xy, 1)
    variance, _ = windows(scene.floor_variance_dn2.astype(float), candidates.peak_xy, 1)
    bad |= ~np.isfinite(data)
    light = np.where(bad | (data < 0), 0.0, data)
    variance = np.where(light > 0, variance + light * np.nan_to_num(scene.gain_dn_per_e), 0.0)
    flux = light.sum(1)
    safe = np.maximum(flux, 1e-12)
    xy = np.einsum("nm,nmi->ni", light, pixels) / safe[:, None]
    arm = (pixels - xy[:, None]) / safe[:, None, None]
    covariance = np.einsum("nmi,nmj,nm->nij", arm, arm, variance)
    return Centroids(xy_px=xy, covariance_px2=covariance, flux_dn=flux, background_dn=np.zeros(len(flux)), ok=flux > 0)
