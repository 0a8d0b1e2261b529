"""The PSF over the field as a PsfMap has it: Gaussian moments, and a point's image at a place."""

from __future__ import annotations

import numpy as np

from ..records import PsfMap
from . import hermite
from ._field import field_terms
from .kernels import gaussian_moments

__all__ = ["FWHM_PER_SIGMA", "field_terms", "light", "moments_at"]

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))
SMALLEST_VARIANCE_PX2 = 0.01
LARGEST_CORRELATION = 0.95
SERIES_PRECISION = 1e-9


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
    # Mehler's series: a tilted Gaussian is sum rho^n h_n(x) h_n(y) of upright ones, each a product of two pixel integrals.
    rho = s_xy / np.sqrt(s_xx * s_yy)
    order = 0 if rho == 0 else int(np.ceil(np.log(SERIES_PRECISION) / np.log(abs(rho))))
    along_x, along_y = (hermite.along(offset, scale, order, pixel_px=pixel_px)[0]
                        for offset, scale in ((dx_px, np.sqrt(s_xx)), (dy_px, np.sqrt(s_yy))))
    return along_y * rho ** np.arange(order + 1) @ along_x.T
