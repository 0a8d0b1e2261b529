"""Gauss-Hermite series of a point's image: integrated over the pixel in closed form.

The light before the pixel is, about the spot's centre, a core and its wings,

    P(x, y) = sum_nm c_nm h_n(x/s) h_m(y/s) g(x/s) g(y/s) / s^2  +  the same to order 2 with a wider scale,

g the normal density, h_n = He_n / sqrt(n!) Hermite's polynomials of probability. From d(He_n-1 g)/dx = -He_n g the integral
over a pixel is a difference at its two edges, so that the basis is exact at any pixel phase and any sharpness, and the light
before the pixel is known as well. Flux and first moment are c_00 and s (c_10, c_01): kept at 1 and 0 by construction
(`free_functions`), they make the series' centre the centre of mass of its light.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from ..records import HermiteShape
from ._field import field_terms

WING_ORDER = 2
WING_FACTOR = 2.5  # wing scale over core scale: found best of 2, 2.5 and 3 on rendered lenses


@lru_cache
def exponents(order: int) -> np.ndarray:
    """(K, 2) orders n, m along x and y with n + m <= order, by total order, then by m."""
    return np.array([(total - m, m) for total in range(order + 1) for m in range(total + 1)])


def free_functions(order: int) -> np.ndarray:
    """(K, F) what each free coefficient puts into the K functions (core, then wings): core of order 2 and up, then all wings.

    A wing's flux and first moment are taken back from the core, so that the sum keeps flux 1 and its centre. In the first
    moment's row stands WING_FACTOR, the ratio of the scales.
    """
    core, wings = exponents(order), exponents(WING_ORDER)
    out = np.eye(len(core) + len(wings))[:, 3:]
    for row, share in enumerate((1.0, WING_FACTOR, WING_FACTOR)):
        out[row, len(core) - 3 + row] = -share
    return out


def coefficients_at(shape: HermiteShape, xy_px: np.ndarray, image_size_px: tuple[int, int]) -> np.ndarray:
    """(N, K) coefficients of all functions, core then wings, at (N, 2) places."""
    free = field_terms(xy_px, image_size_px, shape.degree) @ shape.coefficients.T
    out = free @ free_functions(shape.order).T
    out[:, 0] += 1
    return out


def along(offset_px: np.ndarray, scale_px: float, order: int, *, pixel_px: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """One-dimensional functions (..., order + 1) at offsets (...) from the spot's centre, and their slopes by the offset, 1/px.

    Each is integrated over a pixel of pixel_px; 0: the density itself, per px.
    """
    at = np.asarray(offset_px, float) / scale_px
    if pixel_px == 0:
        dense = _hermite(at, order + 1)
        return dense[..., :-1] / scale_px, -dense[..., 1:] * np.sqrt(np.arange(1, order + 2)) / scale_px**2
    half = pixel_px / (2 * scale_px)
    step = _hermite(at + half, order) - _hermite(at - half, order)
    values = np.empty_like(step)
    values[..., 0] = ndtr(at + half) - ndtr(at - half)
    values[..., 1:] = -step[..., :-1] / np.sqrt(np.arange(1, order + 1))
    return values, step / scale_px


def image(coefficients: np.ndarray, shape: HermiteShape, dx_px: np.ndarray, dy_px: np.ndarray, *,
          pixel_px: float = 1.0) -> np.ndarray:
    """(R, C) light at columns dx (C,) and rows dy (R,) from the centre, of coefficients (K,) at one place."""
    out, first = np.zeros((len(dy_px), len(dx_px))), 0
    for order, scale in ((shape.order, shape.scale_px), (WING_ORDER, WING_FACTOR * shape.scale_px)):
        pairs = exponents(order)
        matrix = np.zeros((order + 1, order + 1))
        matrix[pairs[:, 1], pairs[:, 0]] = coefficients[first:first + len(pairs)]
        x, y = (along(offsets, scale, order, pixel_px=pixel_px)[0] for offsets in (dx_px, dy_px))
        out += y @ matrix @ x.T
        first += len(pairs)
    return out


def transfer(coefficients: np.ndarray, shape: HermiteShape, frequency: np.ndarray) -> np.ndarray:
    """Complex transfer function (F,) of the light before the pixel at frequencies (F, 2) in cycles a pixel; 1 at zero."""
    out, first = np.zeros(len(frequency), complex), 0
    for order, scale in ((shape.order, shape.scale_px), (WING_ORDER, WING_FACTOR * shape.scale_px)):
        pairs = exponents(order)
        turn = -2j * np.pi * scale * np.asarray(frequency)  # the transform of He_n g is (-i k)^n exp(-k^2/2)
        powers = turn[..., None] ** np.arange(order + 1) / np.sqrt(np.cumprod(np.r_[1.0, np.arange(1, order + 1)]))
        terms = powers[:, 0, pairs[:, 0]] * powers[:, 1, pairs[:, 1]]
        out += np.exp((turn**2).real.sum(1) / 2) * (terms @ coefficients[first:first + len(pairs)])
        first += len(pairs)
    return out


def _hermite(at: np.ndarray, order: int) -> np.ndarray:
    """h_n(x) g(x), (..., order + 1)."""
    out = np.empty((*at.shape, order + 1))
    out[..., 0] = np.exp(-at * at / 2) / np.sqrt(2 * np.pi)
    if order:
        out[..., 1] = at * out[..., 0]
    for n in range(1, order):
        out[..., n + 1] = (at * out[..., n] - np.sqrt(n) * out[..., n - 1]) / np.sqrt(n + 1)
    return out
