"""Which pixels stand out: robust deviation from the surroundings, and the rules that need no more than one map.

1. Background: block medians, interpolated (each Bayer plane apart); then row and column medians.
2. Core sigma: block-wise scale from the median absolute deviation, interpolated, so that a glow's shot noise counts.
3. z = deviation / sqrt(core^2 + what the pixel's own noise adds to it); its distribution over normal pixels: `_null`.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d
from scipy.special import chdtri, ndtr

from ..records import DEFECT_FLAGS
from ._quantiles import line_medians, row_medians

BLOCK_PX = 32
SAMPLE_PIXELS = 250_000  # enough for a median: 0.25 % of the spread
LINE_PX = 32  # a run of a row or column in which ...
LINE_SHARE = 0.5  # ... this share of the pixels is defective is a defect of the line
LINE_SIGMA = 5.0
LINES_AROUND = 33


def planes(shape: tuple[int, int], bayer_pattern: str | None) -> Iterator[tuple[slice, slice]]:
    """Slices of the pixels that share a colour filter: four of a Bayer mosaic, else the whole image."""
    if bayer_pattern is None:
        yield np.s_[:, :]
        return
    for row in (0, 1):
        for column in (0, 1):
            yield np.s_[row::2, column::2]


def typical(image: np.ndarray) -> float:
    """Median of an image; of an even sample where it is large."""
    return float(np.median(image.reshape(-1)[:: max(1, image.size // SAMPLE_PIXELS)]))


def _block_medians(image: np.ndarray) -> np.ndarray:
    """Medians of blocks of about BLOCK_PX x BLOCK_PX, of one size, evenly over the image (they may overlap by a pixel)."""
    at, sides = [], []
    for n in image.shape:
        parts = max(1, round(n / BLOCK_PX))
        side = -(-n // parts)
        first = np.rint(np.linspace(0, n - side, parts)).astype(int)
        at.append((first[:, None] + np.arange(side)).ravel())
        sides.append((parts, side))
    (rows, high), (columns, wide) = sides
    out = np.empty((rows, columns), image.dtype)
    for i, band in enumerate(at[0].reshape(rows, high)):  # a band at a time: blocks of the whole image would be two more images
        blocks = image[band][:, at[1]].reshape(high, columns, wide).swapaxes(0, 1).reshape(columns, high * wide)
        out[i] = row_medians(blocks)
    return out


def _spread(blocks: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Block values interpolated to the pixels, bilinear between block centres, constant beyond."""
    return cv2.resize(blocks.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)


def background(image: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) float32: smooth local level plus row and column medians."""
    out = np.empty(image.shape, np.float32)
    for plane in planes(image.shape, bayer_pattern):
        part = np.array(image[plane], np.float32, order="C")
        level = _spread(_block_medians(part), part.shape)
        part -= level
        level += (rows := line_medians(part, 1)[:, None])
        part -= rows
        level += line_medians(part, 0)
        out[plane] = level
    return out


def core_sigma(deviation: np.ndarray, bayer_pattern: str | None) -> np.ndarray:
    """(H, W) float32: local scale of the normal pixels, from the median absolute deviation of blocks, never below that of the
    plane's typical block by more than half (a block of few pixels may be quiet by chance)."""
    out = np.empty(deviation.shape, np.float32)
    for plane in planes(deviation.shape, bayer_pattern):
        part = np.abs(deviation[plane])
        blocks = 1.4826 * _block_medians(part)
        out[plane] = _spread(np.maximum(blocks, 0.5 * np.median(blocks)), part.shape)
    return out


def scale(deviation: np.ndarray, variance: np.ndarray, bayer_pattern: str | None, floor: float) -> np.ndarray:
    """(H, W) standard deviation by which a deviation from the background is judged.

    Args:
        variance: of the value of each pixel. Its typical size is in the core sigma already, only an excess over it is added.
        floor: least variance of a value, from quantisation (coarse data may leave a median deviation of zero).
    """
    out = core_sigma(deviation, bayer_pattern)
    out *= out
    excess = variance - np.float32(typical(variance))
    out += np.maximum(excess, 0, out=excess)
    out += np.float32(floor)
    return np.sqrt(out, out=out)


def noisy(variance: np.ndarray, freedom: int, expected: float, factor: float) -> np.ndarray:
    """(H, W) bool: temporal variance above factor^2 the median, and beyond the chi-squared tail that `expected` pixels pass."""
    limit = max(chdtri(freedom, expected / variance.size) / freedom, factor**2)
    return variance > limit * typical_noise(variance, freedom)


def typical_noise(variance: np.ndarray, freedom: int) -> float:
    """Temporal variance of a typical pixel, at least what quantisation makes (1/12 DN^2); the median of chi-squared undone."""
    return max(typical(variance) / (chdtri(freedom, 0.5) / freedom), 1 / 12)


def never_changing(constant: np.ndarray, variance_dn2: float, frames: int) -> np.ndarray:
    """(H, W) bool: the same value in all frames, where by chance less than 0.1 pixels of typical noise would show that."""
    same = 2 * ndtr(0.5 / np.sqrt(max(variance_dn2, 1e-12))) - 1  # share of frames in the fullest DN step
    return constant if same ** (frames - 1) * constant.size <= 0.1 else np.zeros_like(constant)


def defective_lines(defective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (H, W) bool of defective rows, and of defective columns: runs of LINE_PX pixels of which LINE_SHARE or more are
    defective themselves. A lone line only: where its neighbours are as bad, the fault is an area and no line."""
    out = []
    for axis in (1, 0):
        length = min(LINE_PX, defective.shape[axis])
        if np.count_nonzero(defective, axis=axis).max() < LINE_SHARE * length - 0.5:  # no line has enough of them
            out.append(np.zeros_like(defective))
            continue
        dense = uniform_filter1d(defective.astype(np.float32), length, axis=axis, mode="constant") >= LINE_SHARE - 1e-3
        area = uniform_filter1d(dense.astype(np.float32), 9, axis=1 - axis, mode="nearest") > 0.5
        out.append(maximum_filter1d(dense & ~area, length, axis=axis, mode="constant", origin=-1 if length % 2 == 0 else 0))
    return out[0], out[1]


def lines_above(image: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows (H,) and columns (W,) bool whose median lies above that of the lines around by `limit` and LINE_SIGMA of their
    scatter."""
    found = []
    for axis in (1, 0):
        level = line_medians(image, axis)
        above = level - median_filter(level, LINES_AROUND, mode="nearest")
        found.append(above > max(limit, LINE_SIGMA * 1.4826 * float(np.median(np.abs(above)))))
    return found[0], found[1]


def flags(shape: tuple[int, int], **masks: np.ndarray) -> np.ndarray:
    """(H, W) uint16 of DEFECT_FLAGS from masks by class name."""
    out = np.zeros(shape, np.uint16)
    for name, mask in masks.items():
        out[mask] |= DEFECT_FLAGS[name]
    return out
