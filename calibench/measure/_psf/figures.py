"""What labs quote of a PSF, from a PsfMap at places over the field, of the light as the pixels record it."""

from __future__ import annotations

import numpy as np
from scipy.special import j0, j1

from ...records import PsfMap
from ...spots import hermite
from ...spots.gaussian_fit import fit_gaussians
from ...spots.psf import light, moments_at

PLACES = (5, 5)
FINE = 10  # samples a pixel
BRIGHT_E, FAINT_E, DARK_NOISE_E2 = 1e5, 1e3, 100.0
LEAST_LAMBDA_N_PX = 1.0  # below, the pixel and not the lens decides how much light a diffraction peak puts into one

FIGURES = {  # quantity -> its definition
    "fwhm_x_px": "width of the cut along x through the peak at half maximum, pixel included",
    "fwhm_y_px": "width of the cut along y through the peak at half maximum, pixel included",
    "central_pixel_fraction": "share of the light in the pixel that the spot is centred on",
    "ensquared_3x3_fraction": "share of the light in 3 x 3 pixels, the spot centred on a pixel",
    "ensquared_3x3_worst_fraction": "share of the light in 3 x 3 pixels, at the worst place in the pixel",
    "effective_pixels": "1 / sum p^2 over the pixels' shares p, the spot centred on a pixel",
    "asymmetry": "half of sum |P(r) - P(-r)| about the peak",
    "mtf_nyquist_tangential": "MTF at 0.5 cycles a pixel along the radius, pixel included",
    "mtf_nyquist_sagittal": "MTF at 0.5 cycles a pixel across the radius, pixel included",
    "fwhm_anisotropy": "(largest - smallest) / mean of the FWHM over the field",
    "magnitude_term_px": "drift of a symmetric Gaussian's centroid from 1e3 to 1e5 e-, rms over the field",
}


def places(image_size_px: tuple[int, int]) -> np.ndarray:
    """(N, 2) a grid over the image, 6 % off its edges."""
    x, y = (np.linspace(0.06, 0.94, n) * (size - 1) for n, size in zip(PLACES, image_size_px, strict=True))
    return np.stack([a.ravel() for a in np.meshgrid(x, y)], -1)


def figures(psf: PsfMap, radius_px: int) -> dict[str, float]:
    """Field medians (isotropy: spread over the field) by quantity name."""
    at = [_at_place(psf, xy, radius_px) for xy in places(psf.image_size_px)]
    out = {name: float(np.median([one[name] for one in at])) for name in at[0]}
    widths = [np.sqrt(one["fwhm_x_px"] * one["fwhm_y_px"]) for one in at]
    out["fwhm_anisotropy"] = float(np.ptp(widths) / np.mean(widths))
    out["magnitude_term_px"] = magnitude_term_px(psf, radius_px)
    return out


def _at_place(psf: PsfMap, xy_px: np.ndarray, radius_px: int) -> dict[str, float]:
    fine = np.arange(-radius_px * FINE, radius_px * FINE + 1) / FINE
    image = light(psf, xy_px, fine, fine)
    middle = radius_px * FINE
    pixels = image[middle % FINE::FINE, middle % FINE::FINE]
    half = FINE // 2  # every phase of the spot in its pixel, and the eight pixels around
    near = [slice(middle + FINE * i - half, middle + FINE * i + half + 1) for i in (-1, 0, 1)]
    ensquared = sum(image[rows, columns] for rows in near for columns in near)
    top, left = np.unravel_index(image.argmax(), image.shape)
    return {"fwhm_x_px": _width(image[top], fine), "fwhm_y_px": _width(image[:, left], fine),
            "central_pixel_fraction": float(image[middle, middle]), "ensquared_3x3_fraction": float(ensquared[half, half]),
            "ensquared_3x3_worst_fraction": float(ensquared.min()),
            "effective_pixels": float(pixels.sum() ** 2 / (pixels**2).sum()),
            "asymmetry": float(np.abs(image - _turned(image, top, left)).sum() / image.sum() / 2)} | _transfer(psf, xy_px)


def _width(cut: np.ndarray, fine: np.ndarray) -> float:
    """Width at half of the maximum of a cut, linear between samples."""
    above = np.flatnonzero(cut >= cut.max() / 2)
    first, last = above[0], above[-1]
    step, half = fine[1] - fine[0], cut.max() / 2
    left = (half - cut[first - 1]) / (cut[first] - cut[first - 1]) if first else 0.0
    right = (half - cut[last + 1]) / (cut[last] - cut[last + 1]) if last < len(cut) - 1 else 0.0
    return float(fine[last] - fine[first] + step * (2 - left - right))


def _turned(image: np.ndarray, top: int, left: int) -> np.ndarray:
    """The image turned by half a turn about a sample; what would come from outside is left as it is."""
    rows, columns = 2 * top - np.arange(len(image)), 2 * left - np.arange(len(image))
    inside = ((rows >= 0) & (rows < len(image)))[:, None] & ((columns >= 0) & (columns < len(image)))
    return np.where(inside, image[np.ix_(rows.clip(0, len(image) - 1), columns.clip(0, len(image) - 1))], image)


def _transfer(psf: PsfMap, xy_px: np.ndarray) -> dict[str, float]:
    """MTF at half a cycle a pixel, pixel included.

    Tangential: modulation along the radius from the image's centre; sagittal: across it."""
    from_centre = np.asarray(xy_px) - (np.array(psf.image_size_px) - 1) / 2
    length = np.hypot(*from_centre)
    along = from_centre / length if length > 0 else np.array([1.0, 0.0])
    frequency = 0.5 * np.array([along, [-along[1], along[0]]])
    pixel = np.prod(np.sinc(frequency), axis=1)
    if psf.hermite is not None:
        found = hermite.coefficients_at(psf.hermite, np.asarray(xy_px)[None], psf.image_size_px)[0]
        optics = np.abs(hermite.transfer(found, psf.hermite, frequency))
    else:
        s_xx, s_yy, s_xy = moments_at(psf, np.asarray(xy_px)[None])[0]
        fx, fy = frequency.T
        optics = np.exp(-2 * np.pi**2 * (s_xx * fx**2 + 2 * s_xy * fx * fy + s_yy * fy**2))
    tangential, sagittal = optics * pixel
    return {"mtf_nyquist_tangential": float(tangential), "mtf_nyquist_sagittal": float(sagittal)}


def magnitude_term_px(psf: PsfMap, radius_px: int) -> float:
    """Drift of a symmetric Gaussian's centroid from 1e3 to 1e5 e-, rms over the field: what the map's own fit takes away.

    The map's images without noise, fitted with the weights of each flux (10 e- of dark noise).
    """
    at = places(psf.image_size_px)
    side, offsets = 2 * radius_px + 1, np.arange(-radius_px, radius_px + 1)
    images = np.concatenate([light(psf, xy, offsets, offsets) for xy in at])
    middle = np.column_stack([np.full(len(at), radius_px), radius_px + side * np.arange(len(at))]).astype(float)
    fits = [fit_gaussians(flux * images, np.full(images.shape, DARK_NOISE_E2), np.zeros(images.shape, bool), middle,
                          moments_at(psf, at), gain_dn_per_e=1.0, radius=radius_px).xy_px for flux in (BRIGHT_E, FAINT_E)]
    return float(np.sqrt(np.mean(((fits[0] - fits[1]) ** 2).sum(1))))


def strehl(psf: PsfMap, lambda_n_px: float) -> float:
    """Peak of the recorded light at the field's middle over that of a circular pupil's diffraction through the same pixel.

    Both are shares of the light within the map's window: what lies beyond it looks like background.
    """
    centre = (np.array(psf.image_size_px) - 1) / 2
    fine = np.arange(-FINE, FINE + 1) / FINE
    nodes, weights = np.polynomial.legendre.leggauss(16)
    x, y = np.meshgrid(nodes / 2, nodes / 2)
    v = np.maximum(np.pi * np.hypot(x, y) / lambda_n_px, 1e-9)
    ideal = np.pi / (4 * lambda_n_px**2) * (2 * j1(v) / v) ** 2
    rim = np.pi * (psf.hermite.radius_px if psf.hermite is not None else np.inf) / lambda_n_px
    within = 1 - j0(rim) ** 2 - j1(rim) ** 2 if np.isfinite(rim) else 1.0
    return float(light(psf, centre, fine, fine).max() * within / (ideal * np.outer(weights, weights) / 4).sum())
