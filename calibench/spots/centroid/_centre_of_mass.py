"""Centre of mass in a square window about the peak, over the pixels above zero signal."""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..scene import Centroids, Scene


def centre_of_mass(scene: Scene, candidates: Candidates, radius: int) -> Centroids:
    """Position in windows of 2 radius + 1 pixels. Covariance follows from the pixels' variances; what the window cuts off
    biases the position (3x3: up to 0.25 px) and is not in it. The scene's background is taken as it is."""
    peak = np.ascontiguousarray(candidates.peak_xy, np.int64)
    patches = scene.patches(peak, radius)
    light, variance = np.fmax(patches.signal_dn.astype(float), 0.0), patches.floor_variance_dn2.astype(float)
    variance = np.where(light > 0, variance + light * np.nan_to_num(scene.gain_dn_per_e), 0.0)
    flux = light.sum((1, 2))
    safe = np.maximum(flux, 1e-12)
    offset = np.arange(-radius, radius + 1.0)
    xy = np.stack([(light.sum(1) * offset).sum(1), (light.sum(2) * offset).sum(1)], -1) / safe[:, None]
    arm = np.stack(np.broadcast_arrays(offset[None, None, :] - xy[:, :1, None], offset[None, :, None] - xy[:, 1:, None]), -1)
    arm = arm / safe[:, None, None, None]
    covariance = np.einsum("njia,njib,nji->nab", arm, arm, variance)
    return Centroids(xy_px=peak + xy, covariance_px2=covariance, flux_dn=flux, background_dn=np.zeros(len(flux)), ok=flux > 0)
