"""Which pixels stand out: robust deviation from the surroundings, and thresholds that state their false alarms.

1. Background: block medians, interpolated (each Bayer plane apart); then row and column medians.
2. Core sigma: block-wise scale from the median absolute deviation, interpolated, so that a glow's shot noise counts.
3. z = deviation / sqrt(core^2 + what the pixel's own noise adds to it).
4. Threshold: the Gaussian tail that lets `expected` normal pixels of the frame pass.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.stats import chi2, norm

from ..records import DEFECT_FLAGS

BLOCK_PX = 32


def planes(shape: tuple[int, int], bayer_pattern: str | None) -> Iterator[tuple[slice, slice]]:
    """Slices of the pixels that share a colour filter: four of a Bayer mosaic, else the whole image."""
    if bayer_pattern is None:
        yield np.s_[:, :]
        return
    for row in (0, 1):
        for column in (0, 1):
            yield np.s_[row::2, column::2]


def block_statistic(image: np.ndarray, block_px: int, statistic: callable) -> np.ndarray:
    """A statistic (taking `axis`) of square blocks (rows, columns); the last block of a side takes what is left over."""
    h, w = image.shape
    rows, columns = max(1, round(h / block_px)), max(1, round(w / block_px))
    y, x = (np.linspace(0, n, parts + 1).astype(int) for n, parts in ((h, rows), (w, columns)))
    return np.array([[statistic(image[y[i]:y[i + 1], x[j]:x[j + 1]], axis=None) for j in range(columns)] for i in range(rows)])


def _spread(blocks: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Block values interpolated to the pixels, bilinear between block centres, constant beyond."""
    return cv2.resize(blocks, shape[::-1], interpolation=cv2.INTER_LINEAR)


def background(image: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) smooth local level plus row and column medians."""
    out = np.empty(image.shape)
    for plane in planes(image.shape, bayer_pattern):
        part = image[plane]
        level = _spread(block_statistic(part, BLOCK_PX, np.median), part.shape)
        level = level + np.median(part - level, axis=1, keepdims=True)
        out[plane] = level + np.median(part - level, axis=0, keepdims=True)
    return out


def core_sigma(deviation: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) local scale of the normal pixels, from the median absolute deviation of blocks, never below that of the plane's
    typical block by more than half (a block of few pixels may be quiet by chance)."""
    out = np.empty(deviation.shape)
    for plane in planes(deviation.shape, bayer_pattern):
        part = np.abs(deviation[plane])
        blocks = 1.4826 * block_statistic(part, BLOCK_PX, np.median)
        out[plane] = _spread(np.maximum(blocks, 0.5 * np.median(blocks)), part.shape)
    return out


def significance(deviation: np.ndarray, variance: np.ndarray, bayer_pattern: str | None, floor: float) -> np.ndarray:
    """z (H, W) of a deviation from the background.

    Args:
        variance: of the value of each pixel. Its typical size is in the core sigma already, only an excess over it is added.
        floor: least variance of a value, from quantisation (coarse data may leave a median deviation of zero).
    """
    excess = np.maximum(variance - np.median(variance), 0)
    return deviation / np.sqrt(core_sigma(deviation, bayer_pattern) ** 2 + excess + floor)


def threshold(pixels: int, expected: float) -> float:
    """z that `expected` of `pixels` Gaussian values exceed on one side."""
    return float(norm.isf(min(expected / pixels, 0.5)))


def noisy(variance: np.ndarray, freedom: int, expected: float, factor: float) -> np.ndarray:
    """(H, W) bool: temporal variance above factor^2 the median, and beyond the chi-squared tail that `expected` pixels pass."""
    typical = float(np.nanmedian(variance)) / (chi2.median(freedom) / freedom)
    limit = max(chi2.isf(expected / variance.size, freedom) / freedom, factor**2)
    return variance > limit * max(typical, 1 / 12)  # quantisation alone makes 1/12 DN^2


def never_changing(variance: np.ndarray, frames: int) -> np.ndarray:
    """(H, W) bool: the same value in every frame, where by chance less than 0.1 pixels of typical noise would show that."""
    sigma = np.sqrt(max(float(np.nanmedian(variance)), 1e-12))
    same = 2 * norm.cdf(0.5 / sigma) - 1  # share of frames in the fullest DN step
    if same ** (frames - 1) * variance.size > 0.1:
        return np.zeros(variance.shape, bool)
    return variance == 0


def flags(shape: tuple[int, int], **masks: np.ndarray) -> np.ndarray:
    """(H, W) uint16 of DEFECT_FLAGS from masks by class name."""
    out = np.zeros(shape, np.uint16)
    for name, mask in masks.items():
        out[mask] |= DEFECT_FLAGS[name]
    return out
