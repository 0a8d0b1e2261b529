"""The effective PSF of many dithered spots: positions, fluxes, backgrounds and field coefficients in one least-squares problem.

The normal equations (`normal`) of 490 spots for some 700 coefficients cost one dense solve, and every lower order or degree is
a block of the same matrix: they are all judged by spots that were left out, at the price of their solves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...records import HermiteShape
from ...spots import hermite
from ...spots.psf import field_terms
from .normal import (
    PIXEL_MISFIT,
    PIXEL_SIGMA,
    Normal,
    Windows,
    assembled,
    conditioned,
    functions,
    images,
    moved,
    normal_equations,
    solved,
)

ORDERS, DEGREES = (4, 6, 8), (1, 2, 3, 4)
ROUGH, ROUGH_STEPS = (4, 2), 3
FOLDS = 6
PRIOR_STEPS = 3
CELLS = 12  # spots of one cell of a 12 x 12 grid over the image are left out together: a held-out place, not a held-out frame
SPOTS_PER_TERM = 3
SPOT_SIGMA, SPOT_CHI2 = 8.0, 2.0


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """shape, and the shapes (FOLDS) without one part of the spots each; spots: state of those used; used (N,) bool; chi2 of the
    used spots (N_used,) per degree of freedom; held_out: (order, degree) -> chi2 per pixel of left-out spots."""

    shape: HermiteShape
    without_part: tuple[HermiteShape, ...]
    spots: Windows
    used: np.ndarray
    chi2: np.ndarray
    held_out: dict[tuple[int, int], float]


def fit_shape(spots: Windows, image_size_px: tuple[int, int], *, gain_dn_per_e: float, scale_px: float, pinhole_px: float,
              dither_coverage: float) -> Fitted:
    """The PSF's shape over the field from N spots.

    gain_dn_per_e: for the spots' own shot noise (0: unknown). scale_px: of the core. pinhole_px: diameter of the source's
    image, taken out of the result to the disc's second moment.
    """
    degrees = [d for d in DEGREES if SPOTS_PER_TERM * _terms(d) <= len(spots.xy_px)] or [0]
    known = {"gain": gain_dn_per_e, "pinhole_px": pinhole_px}
    now, used, start = _roughly(spots, image_size_px, min(ROUGH[1], degrees[-1]), scale_px, known)
    now = now.take(used)
    terms, order = field_terms(now.xy_px, image_size_px, degrees[-1]), ORDERS[-1]
    values = np.zeros((len(hermite.free_functions(order).T), terms.shape[1]))
    values[np.ix_(_rows(ROUGH[0]), np.arange(start.shape[1]))] = start
    # A right side belongs to a step from `values`; for the coefficients themselves, matrix @ values is added to it.
    normal = normal_equations(now, values, terms, order, scale_px, robust=True, **known)
    whole, right = assembled(normal, terms, slice(None))
    right += whole @ values.ravel()
    found = solved(whole, right, _prior(whole, right, _groups(degrees[-1]))).reshape(values.shape)
    now, values = moved(now, normal, terms @ (found - values).T), found
    normal = normal_equations(now, values, terms, order, scale_px, robust=True, **known)
    before = values.ravel()
    whole, right = assembled(normal, terms, slice(None))
    prior = _prior(whole, right + whole @ before, _groups(degrees[-1]))
    # The last matrix serves all lower orders and degrees, each judged by the spots of the folds that it has not seen.
    parts, others = _left_out(normal, terms, before, whole, right, _folds(now.xy_px, image_size_px))
    judged = {(o, d): _held_out(parts, others, before, _block(o, d, terms.shape[1]), prior, normal)
              for o in ORDERS for d in degrees}
    order, degree = min(judged, key=judged.get)
    block = _block(order, degree, terms.shape[1])

    def shape(matrix: np.ndarray, right: np.ndarray) -> HermiteShape:
        found = solved(matrix[np.ix_(block, block)], right[block], prior[block])
        return HermiteShape(order=order, degree=degree, scale_px=scale_px, coefficients=found.reshape(-1, _terms(degree)),
                            radius_px=spots.data_dn.shape[1] // 2, core_residual=0.0, dither_coverage=dither_coverage)
    found = shape(whole, right + whole @ before)
    # Figures take their errors from parts that leave no gap in the field: a gap would add what is extrapolated into it.
    mixed = tuple(shape(*rest) for rest in _left_out(normal, terms, before, whole, right, np.arange(len(terms)) % FOLDS)[1])
    terms = field_terms(now.xy_px, image_size_px, degree)
    last = normal_equations(now, found.coefficients, terms, order, scale_px, robust=True, **known)
    now = moved(now, last, np.zeros(last.right.shape))
    residual = _core_residual(now, found, mixed, image_size_px, gain_dn_per_e, pinhole_px)
    return Fitted(shape=replace(found, core_residual=residual), without_part=mixed, spots=now, used=used,
                  chi2=last.chi2 / np.maximum(last.pixels - 4, 1), held_out=judged)


def _roughly(spots: Windows, image_size_px: tuple[int, int], degree: int, scale_px: float,
             known: dict) -> tuple[Windows, np.ndarray, np.ndarray]:
    """Spots after some steps with a shape of few terms, which of them agree on it; it."""
    values = np.zeros((len(hermite.free_functions(ROUGH[0]).T), _terms(degree)))
    for step in range(ROUGH_STEPS):
        terms = field_terms(spots.xy_px, image_size_px, degree)
        normal = normal_equations(spots, values, terms, ROUGH[0], scale_px, robust=step > 0, **known)
        change = solved(*assembled(normal, terms, slice(None))).reshape(values.shape)
        spots, values = moved(spots, normal, terms @ change.T), values + change
    return spots, _agreeing(normal.chi2 / np.maximum(normal.pixels, 1)), values


def _left_out(normal: Normal, terms: np.ndarray, before: np.ndarray, whole: np.ndarray, right: np.ndarray,
              folds: np.ndarray) -> tuple[list, list]:
    """Matrix and right side of each fold's spots for a step, and of all others' for the coefficients themselves."""
    parts = [assembled(normal, terms, folds == fold) for fold in range(FOLDS)]
    return parts, [(whole - part, right - part_right + (whole - part) @ before) for part, part_right in parts]


def _core_residual(spots: Windows, shape: HermiteShape, without: tuple[HermiteShape, ...], image_size_px: tuple[int, int],
                   gain: float, pinhole_px: float) -> float:
    """Rms misfit of the pixels above a fifth of the peak, as a share of it: what the residuals show beyond their noise, and the
    noise of the shape itself (jackknife), twice: the residuals are smaller by what the shape took of their noise."""
    parts = functions(spots, shape.order, shape.scale_px, pinhole_px)

    def unit(one: HermiteShape) -> np.ndarray:
        return images(parts, hermite.coefficients_at(one, spots.xy_px, image_size_px))[0]
    image = unit(shape)
    n, flux = len(image), spots.flux_dn[:, None]
    variance = spots.floor_dn2.reshape(n, -1) + gain * np.maximum(flux * image, 0)
    square = (spots.data_dn.reshape(n, -1) - spots.background_dn[:, None] - flux * image) ** 2
    peak = image.max(1, keepdims=True)
    hit = square > PIXEL_SIGMA**2 * variance + (PIXEL_MISFIT * flux * peak) ** 2
    core = spots.good.reshape(n, -1) & (image > 0.2 * peak) & ~hit
    excess = np.mean(((square - variance) / (flux * peak) ** 2)[core])
    others = np.array([unit(one)[core] for one in without])
    noise = (len(without) - 1) * np.mean(others.var(0) / np.broadcast_to(peak, core.shape)[core] ** 2)
    return float(np.sqrt(max(excess + noise, 0) + noise))


def _terms(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


def _rows(order: int) -> np.ndarray:
    """Free functions of an order among those of the highest: its core, and the wings, which stand last."""
    core, all_core = len(hermite.exponents(order)) - 3, len(hermite.exponents(ORDERS[-1])) - 3
    return np.r_[np.arange(core), all_core + np.arange(len(hermite.exponents(hermite.WING_ORDER)))]


def _block(order: int, degree: int, terms: int) -> np.ndarray:
    return (_rows(order)[:, None] * terms + np.arange(_terms(degree))).ravel()


def _groups(degree: int) -> np.ndarray:
    """(F * terms,) which coefficients are of one kind: order of the core or wings, times degree over the field."""
    core = hermite.exponents(ORDERS[-1]).sum(1)[3:]
    order = np.r_[core, ORDERS[-1] + 1 + hermite.exponents(hermite.WING_ORDER).sum(1)]
    field = hermite.exponents(degree).sum(1)
    return np.unique((order[:, None] * (degree + 1) + field).ravel(), return_inverse=True)[1]


def _prior(matrix: np.ndarray, right: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Inverse variance about zero of each coefficient: that of its kind, as the data show it (empirical Bayes, EM steps).

    A kind that the lens does not have is noise in all its coefficients, and is shrunk away; one that it has is left alone.
    """
    prior = np.zeros(len(matrix))
    for _ in range(PRIOR_STEPS):
        unit, scale = conditioned(matrix, prior)
        covariance = cho_solve(cho_factor(unit, lower=True, check_finite=False), np.eye(len(matrix)), check_finite=False)
        found = covariance @ (right * scale) * scale
        power = found**2 + np.diag(covariance) * scale**2
        prior = 1 / (np.bincount(groups, power) / np.bincount(groups))[groups]
    return prior


def _agreeing(chi2: np.ndarray) -> np.ndarray:
    """Which spots fit as the others do: no blend, ghost or drifting source."""
    middle = np.median(chi2)
    return chi2 < np.maximum(middle + SPOT_SIGMA * 1.4826 * np.median(np.abs(chi2 - middle)), SPOT_CHI2 * middle)


def _folds(xy_px: np.ndarray, image_size_px: tuple[int, int]) -> np.ndarray:
    cell = np.clip((xy_px + 0.5) / np.array(image_size_px) * CELLS, 0, CELLS - 1).astype(int)
    return (cell[:, 0] + 2 * cell[:, 1] + cell[:, 0] * cell[:, 1]) % FOLDS


def _held_out(parts: list, others: list, before: np.ndarray, block: np.ndarray, prior: np.ndarray, normal: Normal) -> float:
    """Chi2 per pixel of the spots of each fold by coefficients from the others (their own four unknowns are their own)."""
    total = normal.chi2.sum()
    for (matrix, part), (rest, rest_right) in zip(parts, others, strict=True):
        found = np.zeros_like(before)
        found[block] = solved(rest[np.ix_(block, block)], rest_right[block], prior[block])
        change = found - before
        total += change @ (matrix @ change) - 2 * change @ part
    return float(total / normal.pixels.sum())
