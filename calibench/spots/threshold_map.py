"""ThresholdMap: what each pixel of a frame shows where there is no star, and from which value on it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .detect.kernels import CELL_PX, ROWS_TOGETHER, fill_thresholds


@dataclass(frozen=True, kw_only=True)
class ThresholdMap:
    """expected_dn (H, W) float32, NaN where a pixel is not used; noise_dn (H, W) float32, 1 sigma; seed_dn (H, W) of the
    frame's type, expected + SEED_SIGMA * noise, beyond reach where a pixel is not used; lowest_dn
    (H / ROWS_TOGETHER, W): the least of it in ROWS_TOGETHER rows; coarse_dn: noise of cells of CELL_PX."""

    expected_dn: np.ndarray
    noise_dn: np.ndarray
    seed_dn: np.ndarray
    lowest_dn: np.ndarray
    coarse_dn: np.ndarray

    @property
    def no_drift(self) -> np.ndarray:
        """The sky's drift in each cell, none: what kernels take for a frame that this map was made from."""
        return np.zeros(self.coarse_dn.shape)


def blocked(dtype: np.dtype) -> np.generic:
    """The threshold that no value of a type exceeds."""
    return dtype.type(np.inf if dtype.kind == "f" else np.iinfo(dtype).max)


def threshold_map(expected_dn: np.ndarray, noise_dn: np.ndarray, dtype: np.dtype) -> ThresholdMap:
    """Threshold map of frames of a type (float32 or uint16) from noise and expectation (H, W; NaN: a pixel not used)."""
    dtype = np.dtype(dtype)
    expected, noise = (np.array(a, np.float32, order="C") for a in (expected_dn, noise_dn))
    seed = np.empty(expected.shape, dtype)
    lowest = np.empty((-(-len(seed) // ROWS_TOGETHER), seed.shape[1]), dtype)
    fill_thresholds(expected, noise, dtype.kind != "f", blocked(dtype), seed, lowest)
    middle = [np.minimum(np.arange(CELL_PX // 2, n + CELL_PX // 2, CELL_PX), n - 1) for n in expected.shape]
    return ThresholdMap(expected_dn=expected, noise_dn=noise, seed_dn=seed, lowest_dn=lowest,
                        coarse_dn=np.float64(noise[np.ix_(*middle)]))
