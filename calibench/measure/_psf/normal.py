"""Normal equations of dithered spots for the coefficients of their common shape, each spot's own unknowns eliminated.

Each pixel is b + F sum_k c_k(u, v) B_k(pixel - centre) (spots/hermite). Eliminating a spot's (x, y, F, b) (Schur complement)
leaves what it says of the coefficients at its place, G_s (F, F), which enters the whole as G_s (x) t t', t the field
polynomial's terms at the spot. The weights are 1/variance of the model (Poisson), not of the data, which would bias the flux.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...spots import hermite

PIXEL_SIGMA, PIXEL_MISFIT = 6.0, 0.03  # a pixel farther off than 6 sigma and 3 % of the peak is a cosmic hit
LARGEST_STEP_PX = 0.5


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Spots cut out: data_dn, floor_dn2 (N, R, R) signal and variance without the spot's own light, good (N, R, R) bool,
    corner_xy (N, 2) pixel of the first column and row; xy_px (N, 2), flux_dn, background_dn (N,) start or state."""

    data_dn: np.ndarray
    floor_dn2: np.ndarray
    good: np.ndarray
    corner_xy: np.ndarray
    xy_px: np.ndarray
    flux_dn: np.ndarray
    background_dn: np.ndarray

    def take(self, rows: np.ndarray) -> Windows:
        return Windows(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@dataclass(frozen=True, kw_only=True)
class Normal:
    """What each spot says of the coefficients, its own unknowns eliminated: matrix (N, F, F), right side (N, F) for a step.
    chi2 and pixels (N,): of what had a weight."""

    matrix: np.ndarray
    right: np.ndarray
    own: np.ndarray
    own_right: np.ndarray
    mixed: np.ndarray
    chi2: np.ndarray
    pixels: np.ndarray


def normal_equations(spots: Windows, values: np.ndarray, terms: np.ndarray, order: int, scale_px: float, *, gain: float,
            pinhole_px: float, robust: bool) -> Normal:
    n = len(spots.xy_px)
    parts, free = functions(spots, order, scale_px, pinhole_px), hermite.free_functions(order)
    coefficients = (terms @ values.T) @ free.T
    coefficients[:, 0] += 1
    unit, slope_x, slope_y = images(parts, coefficients)
    data, floor, good = (a.reshape(n, -1) for a in (spots.data_dn, spots.floor_dn2, spots.good))
    flux = spots.flux_dn[:, None]
    residual = data - spots.background_dn[:, None] - flux * unit
    variance = floor + gain * np.maximum(flux * unit, 0)
    weight = np.where(good, 1 / variance, 0.0)
    if robust:
        weight[np.abs(residual) > PIXEL_SIGMA * np.sqrt(variance) + PIXEL_MISFIT * flux * unit.max(1, keepdims=True)] = 0
    residual = np.where(weight > 0, residual, 0.0)
    own = np.stack([-flux * slope_x, -flux * slope_y, unit, np.ones_like(unit)], -1)
    shared = flux[..., None] * (np.concatenate([_products(x, y) for x, y, _, _ in parts], -1) @ free)
    weighted_own, weighted = weight[..., None] * own, weight[..., None] * shared
    matrix_own = np.swapaxes(own, 1, 2) @ weighted_own + 1e-12 * np.eye(4)
    mixed = np.swapaxes(weighted_own, 1, 2) @ shared
    own_right = np.einsum("nmi,nm->ni", weighted_own, residual)
    inverse = np.linalg.inv(matrix_own)
    solved = np.einsum("nij,nj->ni", inverse, own_right)
    right = (residual[:, None] @ weighted - solved[:, None] @ mixed)[:, 0]
    chi2 = (residual**2 * weight).sum(1) - (own_right * solved).sum(1)
    return Normal(matrix=np.swapaxes(shared, 1, 2) @ weighted - np.swapaxes(mixed, 1, 2) @ inverse @ mixed, right=right,
                   own=inverse, own_right=own_right, mixed=mixed, chi2=chi2, pixels=(weight > 0).sum(1))


def functions(spots: Windows, order: int, scale_px: float, pinhole_px: float) -> list[tuple[np.ndarray, ...]]:
    """For core and wings: functions along x and y (N, R, order + 1), and their slopes, of every window."""
    side = spots.data_dn.shape[1]
    offsets = [spots.corner_xy[:, axis, None] + np.arange(side) - spots.xy_px[:, axis, None] for axis in (0, 1)]
    out = []
    for top, scale in ((order, scale_px), (hermite.WING_ORDER, hermite.WING_FACTOR * scale_px)):
        # A disc of diameter D adds D^2/32 times the Laplacian, and h_n'' is sqrt((n+1)(n+2)) h_n+2 / s^2.
        blur = pinhole_px**2 / 32 / scale**2 * np.sqrt(np.arange(1, top + 2) * np.arange(2, top + 3))
        both = [hermite.along(offset, scale, top + 2) for offset in offsets]
        out.append(tuple(f[..., :-2] + blur * f[..., 2:] for pair in zip(*both, strict=True) for f in pair))
    return out


def _products(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(N, R * R, K) functions in the plane from those along x and y."""
    pairs = hermite.exponents(x.shape[2] - 1)
    return (y[:, :, None, pairs[:, 1]] * x[:, None, :, pairs[:, 0]]).reshape(len(x), -1, len(pairs))


def images(parts: list[tuple[np.ndarray, ...]], coefficients: np.ndarray) -> list[np.ndarray]:
    """Unit images (N, M) of coefficients (N, K), and their slopes by the pixel's x and y."""
    out, first = [0.0, 0.0, 0.0], 0
    for x, y, by_x, by_y in parts:
        pairs = hermite.exponents(x.shape[2] - 1)
        matrix = np.zeros((len(x), x.shape[2], x.shape[2]))
        matrix[:, pairs[:, 1], pairs[:, 0]] = coefficients[:, first:first + len(pairs)]
        first += len(pairs)
        for i, (along_x, along_y) in enumerate(((x, y), (by_x, y), (x, by_y))):
            out[i] = out[i] + (along_y @ matrix @ np.swapaxes(along_x, 1, 2)).reshape(len(x), -1)
    return out


def assembled(normal: Normal, terms: np.ndarray, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The whole matrix and right side of these spots: a sum of G_s (x) t t'."""
    t, count, functions = terms[rows], terms.shape[1], normal.right.shape[1]
    squares = (t[:, :, None] * t[:, None, :]).reshape(len(t), count**2)  # a fold may be empty
    matrix = normal.matrix[rows].reshape(len(t), functions**2).T @ squares
    matrix = matrix.reshape(functions, functions, count, count).swapaxes(1, 2).reshape(functions * count, -1)
    return matrix, (normal.right[rows].T @ t).ravel()


def solved(matrix: np.ndarray, right: np.ndarray, prior: np.ndarray | float = 0.0) -> np.ndarray:
    """Coefficients; prior: inverse variance of each about zero."""
    unit, scale = conditioned(matrix, prior)
    return cho_solve(cho_factor(unit, lower=True, overwrite_a=True, check_finite=False), right * scale) * scale


def conditioned(matrix: np.ndarray, prior: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix with the prior on its diagonal, rows and columns scaled so that this is one, and the scale."""
    diagonal = np.diag(matrix) + prior
    scale = 1 / np.sqrt(np.maximum(diagonal, 1e-30))
    unit = matrix * scale[:, None] * scale
    unit[np.diag_indices_from(unit)] = diagonal * scale**2 + 1e-9
    return unit, scale


def moved(spots: Windows, normal: Normal, change: np.ndarray) -> Windows:
    """Spots after the step of their own unknowns that goes with a change (N, F) of the coefficients at their places."""
    step = np.einsum("nij,nj->ni", normal.own, normal.own_right - np.einsum("nik,nk->ni", normal.mixed, change))
    return replace(spots, xy_px=spots.xy_px + np.clip(step[:, :2], -LARGEST_STEP_PX, LARGEST_STEP_PX),
                   flux_dn=spots.flux_dn + step[:, 2], background_dn=spots.background_dn + step[:, 3])
