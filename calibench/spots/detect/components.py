"""Labelled components over a local threshold (the parallel centre of mass of Hashemi et al., with a local background).

1. Signal over noise, unusable pixels set to zero, smoothed by a small Gaussian (a matched filter: hot pixels fade, stars stay).
2. Pixels above k sigma of the smoothed noise are labelled (8-connected).
3. Each component gives a peak, flux, pixel count and second moments. One too large, or lit in a single pixel, is no star.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..candidates import Candidates
from ..false_alarms import Sensitivity

OWN_K_SIGMA = 5.0  # of the smoothed noise, whatever rate is asked: about 0.1 false alarms a Mpixel on normal noise
SMOOTH_SIGMA_PX = 1.0
FEWEST_PIXELS = 3
LARGEST_FRACTION = 2e-3  # of the frame's area; beyond it: a roof, a moon, a cloud
SHARPEST = 0.85  # of the 3x3 signal in one pixel: a hot pixel, unless the optics are sharper than any star camera's


def detect(signal_dn: np.ndarray, noise_dn: np.ndarray, unusable: np.ndarray, sensitivity: Sensitivity) -> Candidates:
    """Spots of a background-subtracted frame (H, W), local noise (H, W), unusable pixels (H, W) bool."""
    snr = np.where(unusable, 0.0, signal_dn / noise_dn).astype(np.float32)
    smooth = ndimage.gaussian_filter(snr, SMOOTH_SIGMA_PX, truncate=3)
    impulse = np.zeros((13, 13), np.float32)
    impulse[6, 6] = 1
    noise_gain = np.sqrt((ndimage.gaussian_filter(impulse, SMOOTH_SIGMA_PX, truncate=3) ** 2).sum())
    labels, count = ndimage.label(smooth > (sensitivity.k_sigma or OWN_K_SIGMA) * noise_gain, structure=np.ones((3, 3)))
    if count == 0:
        return Candidates.none()
    y, x = np.nonzero(labels)
    owner = labels[y, x] - 1
    light = np.maximum(np.where(unusable, 0.0, signal_dn)[y, x], 1e-6)
    pixels = np.bincount(owner, minlength=count)
    flux = np.bincount(owner, light, count)
    cx, cy = np.bincount(owner, light * x, count) / flux, np.bincount(owner, light * y, count) / flux
    dx, dy = x - cx[owner], y - cy[owner]
    sxx, syy, sxy = (np.bincount(owner, light * v, count) / flux for v in (dx * dx + 1 / 12, dy * dy + 1 / 12, dx * dy))
    half, root = (sxx + syy) / 2, np.sqrt(((sxx - syy) / 2) ** 2 + sxy**2)
    elongation = np.sqrt((half + root) / np.maximum(half - root, 1e-3))
    order = np.lexsort((smooth[y, x], owner))  # the last of each owner is its brightest pixel in the smoothed frame
    last = order[np.cumsum(pixels) - 1]
    px, py = x[last], y[last]
    image = np.pad(np.where(unusable, 0.0, signal_dn), 1)
    around = np.stack([image[py + 1 + j, px + 1 + i] for j in (-1, 0, 1) for i in (-1, 0, 1)])
    sharpness = around.max(0) / np.maximum(np.clip(around, 0, None).sum(0), 1e-6)
    keep = (pixels >= FEWEST_PIXELS) & (pixels <= max(LARGEST_FRACTION * labels.size, 100)) & (sharpness < SHARPEST)
    # A component that spreads far from its peak (nebula, halo) is centred on the peak, not on its mass.
    near_peak = np.hypot(cx - px, cy - py) < 1.5
    xy = np.stack([np.where(near_peak, cx, px), np.where(near_peak, cy, py)], -1)
    return Candidates(xy_px=xy[keep], peak_xy=np.stack([px, py], -1)[keep], peak_dn=around.max(0)[keep], flux_dn=flux[keep],
                      pixels=pixels[keep], elongation=elongation[keep], blend=np.zeros(keep.sum(), bool))
