"""The effective PSF of many dithered spots: positions, fluxes, backgrounds and field coefficients in one least-squares problem.

Each pixel is b + F sum_k c_k(u, v) B_k(pixel - centre) (spots/hermite). A spot's own four unknowns (x, y, F, b) are eliminated
(Schur complement), and what it says of the coefficients at its place, G_s (F, F), enters the whole as G_s (x) t t', t the
polynomial's terms at the spot. So 490 spots and some 700 coefficients cost one dense solve, and every lower order or degree
is a block of the same matrix: they are all judged by spots that were left out, at the price of their solves. The weights are
1/variance of the model (Poisson), not of the data, which would bias the flux.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...records import HermiteShape
from ...spots import hermite
from ...spots.psf import field_terms

ORDERS, DEGREES = (4, 6, 8), (1, 2, 3, 4)
ROUGH, ROUGH_STEPS = (4, 2), 3
FOLDS = 6
PRIOR_STEPS = 3
CELLS = 12  # spots of one cell of a 12 x 12 grid over the image are left out together: a held-out place, not a held-out frame
SPOTS_PER_TERM = 3
PIXEL_SIGMA, PIXEL_MISFIT = 6.0, 0.03  # a pixel farther off than 6 sigma and 3 % of the peak is a cosmic hit
SPOT_SIGMA, SPOT_CHI2 = 8.0, 2.0
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
class Fitted:
    """shape, and the shapes (FOLDS) without one part of the spots each; spots: state of those used; used (N,) bool; chi2 of the
    used spots (N_used,) per degree of freedom; held_out: (order, degree) -> chi2 per pixel of left-out spots."""

    shape: HermiteShape
    without_part: tuple[HermiteShape, ...]
    spots: Windows
    used: np.ndarray
    chi2: np.ndarray
    held_out: dict[tuple[int, int], float]


@dataclass(frozen=True, kw_only=True)
class _Normal:
    """What each spot says of the coefficients, its own unknowns eliminated: matrix (N, F, F), right side (N, F) for a step."""

    matrix: np.ndarray
    right: np.ndarray
    own: np.ndarray
    own_right: np.ndarray
    mixed: np.ndarray
    chi2: np.ndarray
    pixels: np.ndarray


def fit_shape(spots: Windows, image_size_px: tuple[int, int], *, gain_dn_per_e: float, scale_px: float, pinhole_px: float,
              dither_coverage: float) -> Fitted:
    """The PSF's shape over the field from N spots.

    gain_dn_per_e: for the spots' own shot noise (0: unknown). scale_px: of the core. pinhole_px: diameter of the source's
    image, taken out of the result to the disc's second moment.
    """
    degrees = [d for d in DEGREES if SPOTS_PER_TERM * _terms(d) <= len(spots.xy_px)] or [0]
    values = np.zeros((len(hermite.free_functions(ORDERS[-1]).T), _terms(degrees[-1])))

    def step(now: Windows, order: int, degree: int, *, robust: bool) -> tuple[Windows, _Normal, np.ndarray]:
        terms, rows = field_terms(now.xy_px, image_size_px, degree), _rows(order)
        block = np.ix_(rows, np.arange(terms.shape[1]))
        normal = _normal(now, values[block], terms, order, scale_px, gain_dn_per_e, pinhole_px, robust=robust)
        change = _solved(*_assembled(normal, terms, slice(None))).reshape(len(rows), -1)
        values[block] += change
        return _moved(now, normal, terms @ change.T), normal, terms

    now, normal, _ = step(spots, ROUGH[0], min(ROUGH[1], degrees[-1]), robust=False)
    for _ in range(ROUGH_STEPS - 1):
        now, normal, _ = step(now, ROUGH[0], min(ROUGH[1], degrees[-1]), robust=True)
    used = _agreeing(normal.chi2 / np.maximum(normal.pixels, 1))
    now, *_ = step(now.take(used), ORDERS[-1], degrees[-1], robust=True)
    before = values.ravel().copy()
    now, normal, terms = step(now, ORDERS[-1], degrees[-1], robust=True)
    whole, right = _assembled(normal, terms, slice(None))
    prior = _prior(whole, right + whole @ before, _groups(degrees[-1]))
    # A right side belongs to a step from `before`; for the coefficients themselves, matrix @ before is added to it.
    # The last matrix serves all lower orders and degrees, each judged by the spots of the folds that it has not seen.
    folds = _folds(now.xy_px, image_size_px)
    parts = [_assembled(normal, terms, folds == fold) for fold in range(FOLDS)]
    others = [(whole - part, right - part_right + (whole - part) @ before) for part, part_right in parts]
    judged = {(o, d): _held_out(parts, others, before, _block(o, d, terms.shape[1]), prior, normal)
              for o in ORDERS for d in degrees}
    order, degree = min(judged, key=judged.get)
    block = _block(order, degree, terms.shape[1])

    def shape(matrix: np.ndarray, right: np.ndarray) -> HermiteShape:
        found = _solved(matrix[np.ix_(block, block)], right[block], prior[block])
        return HermiteShape(order=order, degree=degree, scale_px=scale_px, coefficients=found.reshape(-1, _terms(degree)),
                            radius_px=spots.data_dn.shape[1] // 2, core_residual=0.0, dither_coverage=dither_coverage)
    without = tuple(shape(*rest) for rest in others)
    found = shape(whole, right + whole @ before)
    terms_used, terms = terms, field_terms(now.xy_px, image_size_px, degree)
    last = _normal(now, found.coefficients, terms, order, scale_px, gain_dn_per_e, pinhole_px, robust=True)
    now = _moved(now, last, np.zeros(last.right.shape))
    residual = _core_residual(now, found, without, image_size_px, gain_dn_per_e, pinhole_px)
    # Figures take their errors from parts that leave no gap in the field: a gap would add what is extrapolated into it.
    apart = [_assembled(normal, terms_used, np.arange(len(folds)) % FOLDS == part) for part in range(FOLDS)]
    mixed = tuple(shape(whole - part, right - part_right + (whole - part) @ before) for part, part_right in apart)
    return Fitted(shape=replace(found, core_residual=residual), without_part=mixed, spots=now, used=used,
                  chi2=last.chi2 / np.maximum(last.pixels - 4, 1), held_out=judged)


def _core_residual(spots: Windows, shape: HermiteShape, without: tuple[HermiteShape, ...], image_size_px: tuple[int, int],
                   gain: float, pinhole_px: float) -> float:
    """Rms misfit of the pixels above a fifth of the peak, as a share of it: what the residuals show beyond their noise, and the
    noise of the shape itself (jackknife over the folds)."""
    parts = _functions(spots, shape.order, shape.scale_px, pinhole_px)

    def unit(one: HermiteShape) -> np.ndarray:
        return _images(parts, hermite.coefficients_at(one, spots.xy_px, image_size_px))[0]
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
    return float(np.sqrt(max(excess, 0) + noise))


def _terms(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


def _rows(order: int) -> np.ndarray:
    """Free functions of an order among those of the highest: its core, and the wings, which stand last."""
    core, all_core = len(hermite.exponents(order)) - 3, len(hermite.exponents(ORDERS[-1])) - 3
    return np.r_[np.arange(core), all_core + np.arange(len(hermite.exponents(hermite.WING_ORDER)))]


def _block(order: int, degree: int, terms: int) -> np.ndarray:
    return (_rows(order)[:, None] * terms + np.arange(_terms(degree))).ravel()


def _normal(spots: Windows, values: np.ndarray, terms: np.ndarray, order: int, scale_px: float, gain: float, pinhole_px: float,
            *, robust: bool) -> _Normal:
    n = len(spots.xy_px)
    parts, free = _functions(spots, order, scale_px, pinhole_px), hermite.free_functions(order)
    coefficients = (terms @ values.T) @ free.T
    coefficients[:, 0] += 1
    unit, slope_x, slope_y = _images(parts, coefficients)
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
    return _Normal(matrix=np.swapaxes(shared, 1, 2) @ weighted - np.swapaxes(mixed, 1, 2) @ inverse @ mixed, right=right,
                   own=inverse, own_right=own_right, mixed=mixed, chi2=chi2, pixels=(weight > 0).sum(1))


def _functions(spots: Windows, order: int, scale_px: float, pinhole_px: float) -> list[tuple[np.ndarray, ...]]:
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


def _images(parts: list[tuple[np.ndarray, ...]], coefficients: np.ndarray) -> list[np.ndarray]:
    """Unit images (N, M) of coefficients (N, K), and their slopes by the pixel's x and y."""
    images, first = [0.0, 0.0, 0.0], 0
    for x, y, by_x, by_y in parts:
        pairs = hermite.exponents(x.shape[2] - 1)
        matrix = np.zeros((len(x), x.shape[2], x.shape[2]))
        matrix[:, pairs[:, 1], pairs[:, 0]] = coefficients[:, first:first + len(pairs)]
        first += len(pairs)
        for i, (along_x, along_y) in enumerate(((x, y), (by_x, y), (x, by_y))):
            images[i] = images[i] + (along_y @ matrix @ np.swapaxes(along_x, 1, 2)).reshape(len(x), -1)
    return images


def _assembled(normal: _Normal, terms: np.ndarray, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The whole matrix and right side of these spots: a sum of G_s (x) t t'."""
    t, count, functions = terms[rows], terms.shape[1], normal.right.shape[1]
    squares = (t[:, :, None] * t[:, None, :]).reshape(len(t), count**2)  # a fold may be empty
    matrix = normal.matrix[rows].reshape(len(t), functions**2).T @ squares
    matrix = matrix.reshape(functions, functions, count, count).swapaxes(1, 2).reshape(functions * count, -1)
    return matrix, (normal.right[rows].T @ t).ravel()


def _solved(matrix: np.ndarray, right: np.ndarray, prior: np.ndarray | float = 0.0) -> np.ndarray:
    """Coefficients; prior: inverse variance of each about zero."""
    conditioned, scale = _conditioned(matrix, prior)
    return cho_solve(cho_factor(conditioned, lower=True, overwrite_a=True, check_finite=False), right * scale) * scale


def _conditioned(matrix: np.ndarray, prior: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix with the prior on its diagonal, rows and columns scaled so that this is one, and the scale."""
    diagonal = np.diag(matrix) + prior
    scale = 1 / np.sqrt(np.maximum(diagonal, 1e-30))
    conditioned = matrix * scale[:, None] * scale
    conditioned[np.diag_indices_from(conditioned)] = diagonal * scale**2 + 1e-9
    return conditioned, scale


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
        conditioned, scale = _conditioned(matrix, prior)
        covariance = cho_solve(cho_factor(conditioned, lower=True, check_finite=False), np.eye(len(matrix)), check_finite=False)
        found = covariance @ (right * scale) * scale
        power = found**2 + np.diag(covariance) * scale**2
        prior = 1 / (np.bincount(groups, power) / np.bincount(groups))[groups]
    return prior


def _moved(spots: Windows, normal: _Normal, change: np.ndarray) -> Windows:
    """Spots after the step of their own unknowns that goes with a change (N, F) of the coefficients at their places."""
    step = np.einsum("nij,nj->ni", normal.own, normal.own_right - np.einsum("nik,nk->ni", normal.mixed, change))
    return replace(spots, xy_px=spots.xy_px + np.clip(step[:, :2], -LARGEST_STEP_PX, LARGEST_STEP_PX),
                   flux_dn=spots.flux_dn + step[:, 2], background_dn=spots.background_dn + step[:, 3])


def _agreeing(chi2: np.ndarray) -> np.ndarray:
    """Which spots fit as the others do: no blend, ghost or drifting source."""
    middle = np.median(chi2)
    return chi2 < np.maximum(middle + SPOT_SIGMA * 1.4826 * np.median(np.abs(chi2 - middle)), SPOT_CHI2 * middle)


def _folds(xy_px: np.ndarray, image_size_px: tuple[int, int]) -> np.ndarray:
    cell = np.clip((xy_px + 0.5) / np.array(image_size_px) * CELLS, 0, CELLS - 1).astype(int)
    return (cell[:, 0] + 2 * cell[:, 1] + cell[:, 0] * cell[:, 1]) % FOLDS


def _held_out(parts: list, others: list, before: np.ndarray, block: np.ndarray, prior: np.ndarray, normal: _Normal) -> float:
    """Chi2 per pixel of the spots of each fold by coefficients from the others (their own four unknowns are their own)."""
    total = normal.chi2.sum()
    for (matrix, part), (rest, rest_right) in zip(parts, others, strict=True):
        found = np.zeros_like(before)
        found[block] = _solved(rest[np.ix_(block, block)], rest_right[block], prior[block])
        change = found - before
        total += change @ (matrix @ change) - 2 * change @ part
    return float(total / normal.pixels.sum())
