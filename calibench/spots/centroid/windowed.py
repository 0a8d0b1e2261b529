"""Iterative centroid under a Gaussian window (SExtractor's XWIN_IMAGE; Bertin and Arnouts 1996), with its covariance.

The window follows the spot: x <- x + 2 sum(w (X - x) I) / sum(w I), until it stands still. It needs no PSF, only a width: the
PSF map's, or the frame's own. The covariance is the sandwich A^-1 B A^-T of the equation sum(w (X - x) I) = 0 that it solves
(A its slope, B the noise that passes through the window). For spots narrower than about 0.6 px the pixels are too coarse
for the window and a bias by pixel phase remains, which is not in the covariance.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..fit.known_shape import window_radius
from ..frame_shape import moments_of
from ..scene import Centroids, Scene
from ._centre_of_mass import with_lost_light

ROUNDS = 30
SETTLED_PX = 1e-4
PIXEL_PX2 = 1 / 12  # second moment of a pixel: the spot as imaged is this much wider
LEAST_DETERMINANT = 1e-12


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Position under a round window as wide as the spot, covariance, flux within it; background is the scene's."""
    moments = moments_of(scene, candidates)
    width2 = (moments[:, :2].mean(1) + PIXEL_PX2)[:, None, None]
    radius = window_radius(moments) + 1
    centre = np.rint(candidates.xy_px).astype(np.int64)
    patches = scene.patches(centre, radius)
    data, variance = patches.signal_dn.astype(float), patches.floor_variance_dn2.astype(float)
    lost = np.isnan(data)
    light = np.where(lost, 0.0, data)
    variance = with_lost_light(variance + np.nan_to_num(scene.gain_dn_per_e) * np.maximum(light, 0), patches.signal_dn)
    offset = np.arange(-radius, radius + 1.0)
    xy = candidates.xy_px - centre
    step = np.full(len(xy), np.inf)
    for _ in range(ROUNDS):
        dx, dy = offset[None, None, :] - xy[:, :1, None], offset[None, :, None] - xy[:, 1:, None]
        window = np.exp(-0.5 * (dx**2 + dy**2) / width2)
        weighed = window * light
        total = weighed.sum((1, 2))
        pull = np.stack([(weighed * dx).sum((1, 2)), (weighed * dy).sum((1, 2))], -1)
        move = 2 * pull / np.where(total > 0, total, np.inf)[:, None]
        step = np.hypot(*move.T)
        if np.all(step < SETTLED_PX):
            break
        xy = xy + np.clip(move, -1, 1)
    arm = np.stack(np.broadcast_arrays(dx, dy), -1)
    slope = np.einsum("nji,njia,njib->nab", weighed / width2, arm, arm) - total[:, None, None] * np.eye(2)
    noise = np.einsum("nji,njia,njib->nab", window**2 * variance, arm, arm)
    fine = (np.abs(np.linalg.det(slope)) > LEAST_DETERMINANT) & (total > 0)
    inverse = np.linalg.inv(np.where(fine[:, None, None], slope, np.eye(2)))
    ok = fine & (step < 10 * SETTLED_PX) & (np.abs(xy).max(1, initial=0) < radius)
    return Centroids(xy_px=centre + xy, covariance_px2=inverse @ noise @ np.swapaxes(inverse, 1, 2),
                     flux_dn=2 * total, background_dn=np.zeros(len(xy)), ok=ok)
