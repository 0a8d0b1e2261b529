"""The smooth part of a flat, lamp and lens fall-off: a polynomial, then a median, of blocks, so that dust does not pull it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.polynomial.polynomial import polygrid2d
from scipy import ndimage

from ..spots.psf import field_terms
from ._defects import block_statistic, planes

BLOCKS_ON_SHORT_SIDE = 24
DEGREE = 6  # cos^4 fall-off to a third of the light, to 0.1 %
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
    values = block_statistic(scaled, side, np.median)
    y, x = (np.linspace(0, n, parts + 1) for n, parts in zip((h, w), values.shape, strict=True))
    grid = np.stack(np.meshgrid((x[1:] + x[:-1] - 1) / 2, (y[1:] + y[:-1] - 1) / 2), -1).reshape(-1, 2)
    degree = min(DEGREE, int(np.sqrt(values.size)) // 3)
    coefficients = _robust_fit(field_terms(grid, (w, h), degree), values.ravel())
    powers = np.zeros((degree + 1, degree + 1))  # of u, v: the terms of a whole image would take 28 times its memory
    order = [(total - v, v) for total in range(degree + 1) for v in range(total + 1)]
    powers[tuple(np.transpose(order))] = coefficients
    smooth = polygrid2d(np.linspace(-1, 1, w), np.linspace(-1, 1, h), powers).T
    # What no polynomial follows (the edge of a lens barrel): the blocks' ratio to it, a median over MEDIAN_BLOCKS^2 of them.
    ratio = ndimage.median_filter(block_statistic(scaled / smooth, side, np.median), MEDIAN_BLOCKS, mode="nearest")
    smooth *= cv2.resize(ndimage.gaussian_filter(ratio, 1.0, mode="nearest"), (w, h), interpolation=cv2.INTER_LINEAR)
    return smooth / smooth.max()


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
