"""The PSF over the field: polynomial terms, and the Gaussian moments of a PsfMap at a place."""

from __future__ import annotations

import numpy as np

from ..records import PsfMap

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))
SMALLEST_VARIANCE_PX2 = 0.01


def field_terms(xy_px: np.ndarray, image_size_px: tuple[int, int], degree: int) -> np.ndarray:
    """(N, 2) pixels -> (N, terms) monomials 1, u, v, u^2, uv, v^2, ... with u, v in [-1, 1] over the image."""
    w, h = image_size_px
    u = 2 * np.asarray(xy_px, float)[:, 0] / (w - 1) - 1
    v = 2 * np.asarray(xy_px, float)[:, 1] / (h - 1) - 1
    return np.stack([u ** (total - power) * v**power for total in range(degree + 1) for power in range(total + 1)], -1)


def moments_at(psf: PsfMap, xy_px: np.ndarray) -> np.ndarray:
    """Second moments (N, 3): s_xx, s_yy, s_xy in px^2 of the PSF (pixel not included) at (N, 2) pixels.

    Kept positive definite: a polynomial may dip below zero outside where it was measured.
    """
    s = field_terms(xy_px, psf.image_size_px, psf.degree) @ psf.coefficients[:3].T
    s[:, :2] = np.maximum(s[:, :2], SMALLEST_VARIANCE_PX2)
    limit = 0.95 * np.sqrt(s[:, 0] * s[:, 1])
    s[:, 2] = np.clip(s[:, 2], -limit, limit)
    return s
