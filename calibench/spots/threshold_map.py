"""ThresholdMap: what each pixel of a frame shows where there is no star, and from which value on it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .detect.kernels import CELL_PX, ROWS_TOGETHER, SEED_SIGMA


@dataclass(frozen=True, kw_only=True)
class ThresholdMap:
    """expected_dn (H, W) float32, NaN where a pixel is not used; noise_dn (H, W) float32, 1 sigma; seed_dn (H, W) of the
    frame's type, expected + SEED_SIGMA * noise, `blocked` where a pixel is not used; lowest_dn
    (H / ROWS_TOGETHER, W): the least of it in ROWS_TOGETHER rows; coarse_dn: noise of cells of CELL_PX."""

    expected_dn: np.ndarray
    noise_dn: np.ndarray
    seed_dn: np.ndarray
    lowest_dn: np.ndarray
    coarse_dn: np.ndarray

    @property
    def blocked(self) -> np.generic:
        return blocked(self.seed_dn.dtype)

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
    expected, noise = (np.ascontiguousarray(a, np.float32) for a in (expected_dn, noise_dn))
    usable = np.isfinite(expected) & (noise > 0) & np.isfinite(noise)
    top = expected + np.float32(SEED_SIGMA) * noise
    if dtype.kind != "f":
        top = np.clip(np.floor(top), 0, blocked(dtype) - 1)  # a value above the floor is above the threshold
    seed = np.full(expected.shape, blocked(dtype))
    seed[usable] = top[usable]
    if not usable.all():
        expected = np.where(usable, expected, np.float32(np.nan))
        noise = np.where(usable, noise, np.float32(1))
    middle = [np.minimum(np.arange(CELL_PX // 2, n + CELL_PX // 2, CELL_PX), n - 1) for n in expected.shape]
    lowest = np.minimum.reduceat(seed, np.arange(0, len(seed), ROWS_TOGETHER), axis=0)
    return ThresholdMap(expected_dn=expected, noise_dn=noise, seed_dn=seed, lowest_dn=lowest,
                        coarse_dn=np.float64(noise[np.ix_(*middle)]))
