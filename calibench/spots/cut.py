"""Square windows cut out of an image."""

from __future__ import annotations

import numpy as np


def cut(image: np.ndarray, centre_xy: np.ndarray, radius: int, outside: object) -> np.ndarray:
    """Windows (N, 2r+1, 2r+1) of an image (H, W) about integer centres (N, 2); `outside` beyond its edge."""
    h, w = image.shape
    reach = np.arange(-radius, radius + 1)
    x, y = centre_xy[:, 0, None, None] + reach, centre_xy[:, 1, None, None] + reach[:, None]
    found = image[np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)]
    found[(x < 0) | (y < 0) | (x >= w) | (y >= h)] = outside
    return found
