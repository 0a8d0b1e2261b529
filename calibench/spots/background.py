"""Local background and noise of a frame: clipped statistics over cells, smoothed and interpolated back to pixels."""

from __future__ import annotations

import numpy as np

from .kernels import cell_statistics, to_pixels

CELL_PX = 32
NOISE_FLOOR_DN = 0.3  # quantisation alone: 1/sqrt(12) DN
# An area is quiet when its noise is within this factor of the frame's quiet quarter; trees and roofs are not.
BUSY_FACTOR = 3.0
OUTLIER_MADS = 4.0
SMOOTHING = np.outer((1, 2, 1), (1, 2, 1)).ravel() / 16


def _neighbours(cells: np.ndarray) -> np.ndarray:
    """(9, rows, columns): each cell and its eight neighbours, beyond the edge continued linearly (vignetting is steep)."""
    padded = np.pad(cells, 1, mode="reflect", reflect_type="odd")
    h, w = cells.shape
    return np.stack([padded[j:j + h, i:i + w] for j in range(3) for i in range(3)])


def without_outliers(cells: np.ndarray, least: np.ndarray | float, otherwise: float) -> np.ndarray:
    """Cells that disagree with their neighbours (a halo, a lamp) replaced by the median of the 3x3: farther from it than
    OUTLIER_MADS deviations of the nine and than `least`. NaN cells (too few usable pixels) are filled with the median of
    all, or `otherwise` where none is known."""
    known = np.isfinite(cells)
    filled = np.where(known, cells, np.median(cells[known]) if known.any() else otherwise)
    nine = _neighbours(filled)
    middle = np.median(nine, axis=0)
    scatter = 1.4826 * np.median(np.abs(nine - middle), axis=0)
    return np.where(np.abs(filled - middle) > OUTLIER_MADS * scatter + least, middle, filled)


def background_and_noise(image: np.ndarray, mask: np.ndarray | None = None, *,
                         floor: float = NOISE_FLOOR_DN) -> tuple[np.ndarray, np.ndarray]:
    """Local background and 1-sigma noise of one pixel.

    Args:
        image: (H, W), DN. mask: (H, W) bool, pixels to leave out; those that are not finite are left out too.
        floor: the least noise.

    Returns:
        background (H, W), noise (H, W), float32, DN. Stars are clipped away (mean, slope and standard deviation of what lies
        within 3.5 sigma), single cells that disagree with their neighbours are replaced by the median of the 3x3.
    """
    values = np.array(image, dtype=np.float32, order="C")
    values[~np.isfinite(values) if mask is None else mask | ~np.isfinite(values)] = np.nan
    level, noise = cell_statistics(values, CELL_PX, floor)
    usable = values[np.isfinite(values)] if not np.isfinite(level).any() else values[:0]  # a frame smaller than a cell
    noise = without_outliers(noise, 0.3 * np.nanmedian(noise) if np.isfinite(noise).any() else 0.0,
                             max(float(np.std(usable)), floor) if usable.size else floor)
    noise = np.tensordot(SMOOTHING, _neighbours(noise), axes=1)  # one cell's is good to 2 %: 10 % of the false alarms
    level = without_outliers(level, noise, float(np.median(usable)) if usable.size else 0.0)
    # A cell's mean lies off a curved sky at its centre by 1/24 of the second difference, straight lines between by 1/12.
    nine = _neighbours(level)
    level = level - (nine[[1, 3, 5, 7]].sum(0) - 4 * level) / 8
    h, w = values.shape
    return to_pixels(level, CELL_PX, h, w), np.maximum(to_pixels(noise, CELL_PX, h, w), np.float32(floor))


def busy_area(noise_dn: np.ndarray) -> np.ndarray:
    """(H, W) bool: where the scene itself is restless (branches, a roof, clouds' edges) and a spot is hardly a star."""
    return noise_dn > BUSY_FACTOR * np.quantile(noise_dn[::8, ::8], 0.25)
