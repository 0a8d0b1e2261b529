"""Centre of mass in a square window about the peak, over the pixels above zero signal."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from ..candidates import Candidates
from ..scene import Centroids, Scene


def centre_of_mass(scene: Scene, candidates: Candidates, radius: int) -> Centroids:
    """Position in windows of 2 radius + 1 pixels. Covariance follows from the pixels' variances; what the window cuts off
    biases the position (3x3: up to 0.25 px) and is not in it. The scene's background is taken as it is."""
    peak = np.ascontiguousarray(candidates.peak_xy, np.int64)
    patches = scene.patches(peak, radius)
    light = np.fmax(patches.signal_dn.astype(float), 0.0)
    variance = np.where(light > 0, patches.floor_variance_dn2 + light * np.nan_to_num(scene.gain_dn_per_e), 0.0)
    variance = with_lost_light(variance, patches.signal_dn)
    flux = light.sum((1, 2))
    safe = np.maximum(flux, 1e-12)
    offset = np.arange(-radius, radius + 1.0)
    xy = np.stack([(light.sum(1) * offset).sum(1), (light.sum(2) * offset).sum(1)], -1) / safe[:, None]
    arm = np.stack(np.broadcast_arrays(offset[None, None, :] - xy[:, :1, None], offset[None, :, None] - xy[:, 1:, None]), -1)
    arm = arm / safe[:, None, None, None]
    covariance = np.einsum("njia,njib,nji->nab", arm, arm, variance)
    return Centroids(xy_px=peak + xy, covariance_px2=covariance, flux_dn=flux, background_dn=np.zeros(len(flux)), ok=flux > 0)


def with_lost_light(variance_dn2: np.ndarray, signal_dn: np.ndarray) -> np.ndarray:
    """Variance (N, n, n) of the pixels of windows whose lost ones (signal NaN) count as dark: each may hold as much light as
    the brightest pixel next to it, so that a saturated star's place is not believed to the hundredth of a pixel."""
    lost = np.isnan(signal_dn)
    if not lost.any():
        return variance_dn2
    beside = maximum_filter(np.where(lost, 0.0, signal_dn), size=(1, 3, 3))
    return np.where(lost, np.maximum(beside, 0.0) ** 2, variance_dn2)
