"""Polynomials over the field, in which a PSF map is written."""

from __future__ import annotations

import numpy as np


def field_terms(xy_px: np.ndarray, image_size_px: tuple[int, int], degree: int) -> np.ndarray:
    """(N, 2) pixels -> (N, terms) monomials 1, u, v, u^2, uv, v^2, ... with u, v in [-1, 1] over the image."""
    w, h = image_size_px
    u = 2 * np.asarray(xy_px, float)[:, 0] / (w - 1) - 1
    v = 2 * np.asarray(xy_px, float)[:, 1] / (h - 1) - 1
    return np.stack([u ** (total - power) * v**power for total in range(degree + 1) for power in range(total + 1)], -1)
