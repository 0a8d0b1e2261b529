"""The smooth part of a flat: lamp (a polynomial) times lens (a radial profile), by medians, so that dust does not pull it.

1. A low polynomial over the medians of blocks follows the lamp and the cos^4 fall-off.
2. The median of what is left in rings about the image's centre follows what is round and sharp: the edge of a lens barrel.
3. Both again, each on what the other leaves (ROUNDS times), then the blocks' own median for what is neither.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.polynomial.polynomial import polygrid2d
from scipy import ndimage

from ...spots.psf import field_terms
from .._defects import block_statistic, planes

BLOCKS_ON_SHORT_SIDE = 24
DEGREE = 4
ROUNDS = 3
RINGS = 56  # between the centre and a corner
FEWEST_IN_RING = 20
CLIP_SIGMA = 3.0
MEDIAN_BLOCKS = 5  # wider than two dust shadows


def illumination(signal_dn: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) smooth illumination, 1 at its brightest; each Bayer plane is scaled to the same median first."""
    scaled = np.empty(signal_dn.shape)
    for plane in planes(signal_dn.shape, bayer_pattern):
        scaled[plane] = signal_dn[plane] / np.median(signal_dn[plane])
    h, w = scaled.shape
    side = max(4, min(h, w) // BLOCKS_ON_SHORT_SIDE)
    side += side % 2 if bayer_pattern else 0  # whole mosaic cells
    smooth = np.ones((h, w))
    for _ in range(ROUNDS):
        smooth *= _polynomial(block_statistic(scaled / smooth, side, np.median), (w, h))
        smooth *= _radial(scaled / smooth)
    ratio = ndimage.median_filter(block_statistic(scaled / smooth, side, np.median), MEDIAN_BLOCKS, mode="nearest")
    smooth *= cv2.resize(ndimage.gaussian_filter(ratio, 1.0, mode="nearest"), (w, h), interpolation=cv2.INTER_LINEAR)
    return smooth / smooth.max()


def _polynomial(values: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Polynomial of DEGREE through block values, evaluated at every pixel (H, W)."""
    w, h = size_px
    y, x = (np.linspace(0, n, parts + 1) for n, parts in zip((h, w), values.shape, strict=True))
    grid = np.stack(np.meshgrid((x[1:] + x[:-1] - 1) / 2, (y[1:] + y[:-1] - 1) / 2), -1).reshape(-1, 2)
    degree = min(DEGREE, int(np.sqrt(values.size)) // 3)
    coefficients = _robust_fit(field_terms(grid, (w, h), degree), values.ravel())
    powers = np.zeros((degree + 1, degree + 1))  # of u, v: the terms of a whole image would take 15 times its memory
    order = [(total - v, v) for total in range(degree + 1) for v in range(total + 1)]
    powers[tuple(np.transpose(order))] = coefficients
    return polygrid2d(np.linspace(-1, 1, w), np.linspace(-1, 1, h), powers).T


def _radial(ratio: np.ndarray) -> np.ndarray:
    """Median of `ratio` in rings about the image's centre, smoothed over neighbouring rings, at every pixel (H, W)."""
    h, w = ratio.shape
    radius = np.hypot(*np.meshgrid(np.arange(w) - (w - 1) / 2, np.arange(h) - (h - 1) / 2))
    width = radius.max() / RINGS
    ring = np.minimum((radius / width).astype(np.int32), RINGS - 1).ravel()
    order = np.argsort(ring, kind="stable")
    parts = np.split(ratio.ravel()[order], np.searchsorted(ring[order], np.arange(1, RINGS)))
    wide = [i for i, part in enumerate(parts) if part.size >= FEWEST_IN_RING]
    if len(wide) < 2:
        return np.ones((h, w))
    profile = ndimage.gaussian_filter1d([np.median(parts[i]) for i in wide], 1.0, mode="nearest")
    return np.interp(radius, (np.array(wide) + 0.5) * width, profile)


def _robust_fit(terms: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Least squares, repeated without the values beyond CLIP_SIGMA robust sigma until these stay the same."""
    keep = np.ones(len(values), bool)
    for _ in range(10):
        coefficients = np.linalg.lstsq(terms[keep], values[keep], rcond=None)[0]
        residual = values - terms @ coefficients
        sigma = 1.4826 * np.median(np.abs(residual[keep]))
        now = np.abs(residual) <= max(CLIP_SIGMA * sigma, 1e-12)
        if (now == keep).all() or now.sum() < 2 * terms.shape[1]:
            break
        keep = now
    return coefficients
