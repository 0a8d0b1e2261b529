"""The smooth part of a flat: lamp (a polynomial) times lens (a radial profile), by medians, so that dust does not pull it.

1. A low polynomial over the medians of blocks follows the lamp and the cos^4 fall-off.
2. The median of what is left in rings about the image's centre follows what is round and sharp: the edge of a lens barrel.
3. Both again, each on what the other leaves (ROUNDS times), then the blocks' own median for what is neither.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyvander
from scipy import ndimage

from ...spots.psf import field_terms
from .._defects import planes
from .._quantiles import row_medians

BLOCKS_ON_SHORT_SIDE = 24
DEGREE = 4
ROUNDS = 3
RINGS = 56  # between the centre and a corner
FEWEST_IN_RING = 20
CLIP_SIGMA = 3.0
MEDIAN_BLOCKS = 5  # wider than two dust shadows


def illumination(signal_dn: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) float32 smooth illumination, 1 at its brightest; each Bayer plane is scaled to the same median first."""
    scaled = np.empty(signal_dn.shape, np.float32)
    for plane in planes(signal_dn.shape, bayer_pattern):
        scaled[plane] = signal_dn[plane] / row_medians(signal_dn[plane].ravel())
    h, w = scaled.shape
    side = max(4, min(h, w) // BLOCKS_ON_SHORT_SIDE)
    side += side % 2 if bayer_pattern else 0  # whole mosaic cells
    smooth, rings = np.ones((h, w), np.float32), _Rings((w, h))
    for _ in range(ROUNDS):
        smooth *= _polynomial(_block_medians(scaled / smooth, side), (w, h))
        smooth *= rings.smooth_medians(scaled / smooth)
    ratio = ndimage.median_filter(_block_medians(scaled / smooth, side), MEDIAN_BLOCKS, mode="nearest")
    smooth *= cv2.resize(ndimage.gaussian_filter(ratio, 1.0, mode="nearest"), (w, h), interpolation=cv2.INTER_LINEAR)
    smooth /= smooth.max()
    return smooth


def _block_medians(image: np.ndarray, block_px: int) -> np.ndarray:
    """Medians of square blocks (rows, columns); the last block of a side takes what is left over."""
    h, w = image.shape
    rows, columns = max(1, round(h / block_px)), max(1, round(w / block_px))
    y, x = (np.linspace(0, n, parts + 1).astype(int) for n, parts in ((h, rows), (w, columns)))
    return np.array([[row_medians(image[y[i]:y[i + 1], x[j]:x[j + 1]].ravel()) for j in range(columns)] for i in range(rows)])


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
    of_u, of_v = (polyvander(np.linspace(-1, 1, n), degree) for n in (w, h))
    return of_v @ powers.T @ of_u.T


class _Rings:
    """Rings about the centre of an image of `size_px`, all of one width. Its upper left quarter stands for the whole."""

    def __init__(self, size_px: tuple[int, int]):
        columns, rows = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in size_px)
        self._whole = np.ix_(rows, columns)  # from a quarter
        x, y = (np.arange((n + 1) // 2) - (n - 1) / 2 for n in size_px)
        radius = np.hypot(x, y[:, None])
        self._at = radius / (radius.max() / RINGS)
        ring = np.minimum(self._at, RINGS - 1).astype(np.uint8)[self._whole].ravel()
        self._order = np.argsort(ring, kind="stable")  # pixels ring by ring
        self._starts = np.cumsum(np.bincount(ring, minlength=RINGS))[:-1]

    def smooth_medians(self, ratio: np.ndarray) -> np.ndarray:
        """Median of `ratio` (H, W) in each ring, smoothed over neighbouring rings, at every pixel (H, W)."""
        parts = np.split(np.take(ratio, self._order), self._starts)
        wide = [i for i, part in enumerate(parts) if part.size >= FEWEST_IN_RING]
        if len(wide) < 2:
            return np.ones(ratio.shape, np.float32)
        profile = ndimage.gaussian_filter1d([row_medians(parts[i]) for i in wide], 1.0, mode="nearest")
        return np.interp(self._at, np.array(wide) + 0.5, profile).astype(np.float32)[self._whole]


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
