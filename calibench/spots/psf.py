"""The PSF over the field as a PsfMap has it: Gaussian moments, and a point's image at a place."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ..records import PsfMap
from . import hermite
from ._field import field_terms
from .kernels import gaussian_moments

__all__ = ["FWHM_PER_SIGMA", "field_terms", "light", "moments_at"]

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))
SMALLEST_VARIANCE_PX2 = 0.01
LARGEST_CORRELATION = 0.95


def moments_at(psf: PsfMap, xy_px: np.ndarray) -> np.ndarray:
    """Second moments (N, 3): s_xx, s_yy, s_xy in px^2 of the nearest Gaussian (pixel not included) at (N, 2) pixels.

    Kept positive definite: a polynomial may dip below zero outside where it was measured.
    """
    s = np.empty((len(xy_px), 3))
    gaussian_moments(np.ascontiguousarray(xy_px, float), np.ascontiguousarray(psf.coefficients[:3], float), psf.degree,
                     *psf.image_size_px, SMALLEST_VARIANCE_PX2, LARGEST_CORRELATION, s)
    return s


def light(psf: PsfMap, xy_px: np.ndarray, dx_px: np.ndarray, dy_px: np.ndarray, *, pixel_px: float = 1.0) -> np.ndarray:
    """(R, C) share of a point's light in pixels of side pixel_px centred dx (C,), dy (R,) from the spot's centre at xy (2,).

    pixel_px 0: the density before the pixel, per px^2.
    """
    place = np.asarray(xy_px, float)[None]
    if psf.hermite is not None:
        found = hermite.coefficients_at(psf.hermite, place, psf.image_size_px)[0]
        return hermite.image(found, psf.hermite, dx_px, dy_px, pixel_px=pixel_px)
    s_xx, s_yy, s_xy = moments_at(psf, place)[0]
    sigma = np.sqrt(s_xx - s_xy**2 / s_yy)  # along x, on a given y
    x, total = np.asarray(dx_px, float), 0.0
    for node, weight in zip(*np.polynomial.legendre.leggauss(7 if pixel_px else 1), strict=True):
        y = np.asarray(dy_px, float)[:, None] + node * pixel_px / 2
        middle = s_xy / s_yy * y
        along_x = (ndtr((x + pixel_px / 2 - middle) / sigma) - ndtr((x - pixel_px / 2 - middle) / sigma) if pixel_px
                   else np.exp(-(((x - middle) / sigma) ** 2) / 2) / np.sqrt(2 * np.pi) / sigma)
        total = total + weight / 2 * along_x * np.exp(-(y**2) / (2 * s_yy))
    return total / np.sqrt(2 * np.pi * s_yy) * (pixel_px or 1.0)
