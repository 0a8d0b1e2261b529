"""The PSF over the field from the spots of all frames: the Gaussian member, then the shape where the spots carry one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...records import CENTRE_OF_MASS, PsfMap
from ...spots.gaussian_fit import fit_gaussians
from ...spots.psf import field_terms, moments_at
from .epsf import FOLDS, Fitted, Windows, fit_shape
from .spot_shapes import SpotShapes

CLIP_SIGMA = 4.0
SPOTS_PER_TERM = 3
DEGREES = (4, 3, 2, 1, 0)
PHASES = 4
CORE_PER_SIGMA = (0.35, 0.5, 0.75, 1.5), (1.2, 1.15, 1.0, 0.8)  # series' scale over sigma, by sigma in px: on rendered lenses


@dataclass(frozen=True, kw_only=True)
class FieldPsf:
    """psf, and the maps without one part of the spots each; fitted: the shape's fit, None where the map has none, `why_not`.

    Of all spots: xy_px (N, 2), moments_px2 and residual_px2 (N, 3) about the map, used (N,) bool.
    """

    psf: PsfMap
    without_part: tuple[PsfMap, ...]
    fitted: Fitted | None
    why_not: str
    xy_px: np.ndarray
    moments_px2: np.ndarray
    residual_px2: np.ndarray
    used: np.ndarray


def over_field(found: Sequence[SpotShapes], image_size_px: tuple[int, int], *, gain_dn_per_e: float, shape_spots: int,
               dither: float, pinhole_px: float) -> FieldPsf:
    """The PSF of all frames' spots; shape_spots, dither, pinhole_px as in the measurement's Settings."""
    xy, moments = (np.concatenate([getattr(s, name) for s in found]) for name in ("xy_px", "moments_px2"))
    joined = {name: np.concatenate([getattr(s.windows, name) for s in found]) for name in Windows.__dataclass_fields__}
    psf, residual, used = gaussian_member(xy, moments, image_size_px)
    parts = np.arange(used.sum()) % FOLDS
    others = [_polynomial(xy[used][parts != part], moments[used][parts != part], psf) for part in range(FOLDS)]
    psf, fitted, why_not = _with_shape(psf, Windows(**joined).take(used), gain_dn_per_e, shape_spots, dither, pinhole_px)
    if fitted is not None:
        others = [replace(psf, coefficients=other.coefficients, hermite=shape)
                  for other, shape in zip(others, fitted.without_part, strict=True)]
    return FieldPsf(psf=psf, without_part=tuple(others), fitted=fitted, why_not=why_not, xy_px=xy, moments_px2=moments,
                    residual_px2=residual, used=used)


def gaussian_member(xy_px: np.ndarray, moments_px2: np.ndarray,
                    image_size_px: tuple[int, int]) -> tuple[PsfMap, np.ndarray, np.ndarray]:
    """PsfMap of moments (N, 3) at (N, 2) as polynomials, residual (N, 3) of every spot and which spots were used."""
    used = np.ones(len(xy_px), bool)
    for _ in range(8):
        degree = next(d for d in DEGREES if d == 0 or SPOTS_PER_TERM * (d + 1) * (d + 2) // 2 <= used.sum())
        terms = field_terms(xy_px, image_size_px, degree)
        coefficients = np.linalg.lstsq(terms[used], moments_px2[used], rcond=None)[0]
        residual = moments_px2 - terms @ coefficients
        sigma = 1.4826 * np.median(np.abs(residual[used]), axis=0)
        now = (np.abs(residual) <= CLIP_SIGMA * sigma + 1e-9).all(axis=1)
        if (now == used).all() or now.sum() < 0.7 * len(xy_px):
            break
        used = now
    psf = PsfMap(model="gaussian", degree=degree, coefficients=coefficients.T, image_size_px=image_size_px,
                 centre="centre of the Gaussian fitted by least squares, integrated over the pixels",
                 measured_xy_px=xy_px[used], residual_rms_px2=float(np.sqrt(np.mean(residual[used] ** 2))))
    return psf, residual, used


def _polynomial(xy_px: np.ndarray, moments_px2: np.ndarray, psf: PsfMap) -> PsfMap:
    """The Gaussian member of the same degree from these spots alone."""
    terms = field_terms(xy_px, psf.image_size_px, psf.degree)
    return replace(psf, coefficients=np.linalg.lstsq(terms, moments_px2, rcond=None)[0].T)


def dither_coverage(xy_px: np.ndarray) -> float:
    """Share of the 4 x 4 parts of a pixel in which some spot (N, 2) is centred."""
    part = np.floor(PHASES * ((xy_px + 0.5) % 1)).astype(int).clip(0, PHASES - 1)
    return len(np.unique(part[:, 0] * PHASES + part[:, 1])) / PHASES**2


def _with_shape(psf: PsfMap, spots: Windows, gain: float, shape_spots: int, dither: float,
                pinhole_px: float) -> tuple[PsfMap, Fitted | None, str]:
    """The map with its shape, and how it was fitted; or the map as it is, None, and why."""
    coverage = dither_coverage(spots.xy_px)
    if len(spots.xy_px) < shape_spots:
        return psf, None, f"{len(spots.xy_px)} spots, a shape needs {shape_spots}"
    if coverage < dither:
        return psf, None, (f"the spots are centred in {100 * coverage:.0f} % of the pixel's parts, a shape needs "
                           f"{100 * dither:.0f} %: move the source by fractions of a pixel")
    gain = gain if np.isfinite(gain) else 0.0
    moments = moments_at(psf, spots.xy_px)
    sigma = float(np.sqrt(np.median(moments[:, :2])))
    scale = sigma * float(np.interp(sigma, *CORE_PER_SIGMA))
    fitted = fit_shape(spots, psf.image_size_px, gain_dn_per_e=gain, scale_px=scale, pinhole_px=pinhole_px,
                       dither_coverage=coverage)
    if fitted.used.sum() < shape_spots:
        return psf, None, f"only {fitted.used.sum()} of {len(fitted.used)} spots agree on a shape"
    gaussian, held_out = _gaussian_chi2(spots.take(fitted.used), moments[fitted.used], gain), min(fitted.held_out.values())
    if gaussian <= held_out:
        return psf, None, (f"it describes the spots as well as a shape with more freedom predicts them (chi2 per pixel "
                           f"{gaussian:.3f}, {held_out:.3f})")
    return replace(psf, model="gauss_hermite", centre=CENTRE_OF_MASS, hermite=fitted.shape), fitted, ""


def _gaussian_chi2(spots: Windows, moments: np.ndarray, gain: float) -> float:
    """Chi2 per pixel of the Gaussian member, the windows set one below the other into one image."""
    count, side = spots.data_dn.shape[:2]
    radius = side // 2
    shift = np.column_stack([np.zeros(count), side * np.arange(count)]) - spots.corner_xy
    stacked = [a.reshape(count * side, side) for a in (spots.data_dn, spots.floor_dn2, ~spots.good)]
    fit = fit_gaussians(*stacked, spots.xy_px + shift, moments, gain_dn_per_e=gain, radius=radius)
    pixels = spots.good.sum((1, 2))
    return float((fit.chi2_per_dof * (pixels - 4))[fit.converged].sum() / pixels[fit.converged].sum())
