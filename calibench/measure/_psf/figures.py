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
    "ee80_anisotropy": "(largest - smallest) / mean of the radius of 80 % of the light over the field",
    "ellipticity_95": "1 - b/a that 95 % of the field stay below; Gaussian moments, pixel integration taken out",
    "ellipticity_common": "part of (e1, e2) that is alike over the field, as 1 - b/a: a drift, a tilt, a squeezed lens",
    "ellipticity_radial": "field mean of e1 cos 2f + e2 sin 2f without the common part: along the radius where positive",
    "magnitude_term_px": "drift of a symmetric Gaussian's centroid from 1e3 to 1e5 e-, rms over the field",
}


def places(image_size_px: tuple[int, int]) -> np.ndarray:
    """(N, 2) a grid over the image, 6 % off its edges."""
    x, y = (np.linspace(0.06, 0.94, n) * (size - 1) for n, size in zip(PLACES, image_size_px, strict=True))
    return np.stack([a.ravel() for a in np.meshgrid(x, y)], -1)


def figures(psf: PsfMap, radius_px: int) -> dict[str, float]:
    """Field medians (what FIGURES says otherwise: over the field) by quantity name, and e1, e2 of the common ellipticity."""
    at = figures_at(psf, places(psf.image_size_px), radius_px)
    ellipticity, angle, ee80 = (at.pop(name) for name in ("ellipticity", "angle_rad", "ee80_radius_px"))
    out = {name: float(np.median(values)) for name, values in at.items()}
    widths = np.sqrt(at["fwhm_x_px"] * at["fwhm_y_px"])
    out["fwhm_anisotropy"] = float(np.ptp(widths) / np.mean(widths))
    out["ee80_anisotropy"] = float(np.ptp(ee80) / np.mean(ee80))
    out["ellipticity_95"] = float(np.percentile(ellipticity, 95))
    axes2 = (1 - ellipticity) ** 2
    e = (1 - axes2) / (1 + axes2) * np.array([np.cos(2 * angle), np.sin(2 * angle)])
    out["e1"], out["e2"], out["ellipticity_radial"] = _common_and_radial(e, psf.image_size_px)
    out["ellipticity_common"] = _flattening(np.hypot(out["e1"], out["e2"]))
    out["magnitude_term_px"] = magnitude_term_px(psf, radius_px)
    return out


def _common_and_radial(e: np.ndarray, image_size_px: tuple[int, int]) -> tuple[float, float, float]:
    """Common e1 and e2, and the mean ellipticity along the radius, of (2, N) at `places`.

    A lens symmetric about the image's centre has e along or across the radius, as r^2 and r^4; over a rectangle its mean does
    not vanish. So the common part is fitted beside it.
    """
    offset = (places(image_size_px) - (np.array(image_size_px) - 1) / 2) / image_size_px[0]
    r2, twice = (offset**2).sum(1), 2 * np.arctan2(offset[:, 1], offset[:, 0])
    along = np.array([np.cos(twice), np.sin(twice)])
    common = np.repeat(np.eye(2), len(r2), axis=0)
    terms = np.column_stack([common, (along * r2).ravel(), (along * r2**2).ravel()])
    found = np.linalg.lstsq(terms, e.ravel(), rcond=None)[0][:2]
    return float(found[0]), float(found[1]), float(np.mean(((e - found[:, None]) * along).sum(0)))


def _flattening(e: float) -> float:
    """1 - b/a of an ellipticity (a^2 - b^2) / (a^2 + b^2)."""
    return float(1 - np.sqrt((1 - e) / (1 + e)))


def figures_at(psf: PsfMap, xy_px: np.ndarray, radius_px: int) -> dict[str, np.ndarray]:
    """Figures (N,) at places (N, 2) by name: those of FIGURES that a single place has, and ellipticity, angle_rad (of the major
    axis, from x towards y), ee80_radius_px."""
    fine = np.arange(-radius_px * FINE, radius_px * FINE + 1) / FINE
    rings = np.hypot(fine, fine[:, None]).ravel()
    order = rings.argsort()
    found = [_at_place(psf, xy, fine, radius_px, (order, rings[order])) for xy in xy_px]
    out = {name: np.array([one[name] for one in found]) for name in found[0]}
    s_xx, s_yy, s_xy = moments_at(psf, xy_px).T
    half = np.hypot((s_xx - s_yy) / 2, s_xy)
    out["ellipticity"] = 1 - np.sqrt(np.maximum((s_xx + s_yy) / 2 - half, 0) / ((s_xx + s_yy) / 2 + half))
    out["angle_rad"] = np.arctan2(2 * s_xy, s_xx - s_yy) / 2
    return out


def pixel_shares(psf: PsfMap, xy_px: np.ndarray, radius_px: int, phases: int) -> np.ndarray:
    """(phases^2, R, R) shares of the light in the pixels about a spot at xy (2,), centred anywhere in its pixel."""
    offsets = np.arange(-(radius_px + 0.5) * phases, (radius_px + 0.5) * phases) / phases + 0.5 / phases
    image = light(psf, xy_px, offsets, offsets)
    side = 2 * radius_px + 1
    return image.reshape(side, phases, side, phases).transpose(1, 3, 0, 2).reshape(phases**2, side, side)


def _at_place(psf: PsfMap, xy_px: np.ndarray, fine: np.ndarray, radius_px: int,
              rings: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
    image = light(psf, xy_px, fine, fine)
    middle = radius_px * FINE
    pixels = image[middle % FINE::FINE, middle % FINE::FINE]
    half = FINE // 2  # every phase of the spot in its pixel, and the eight pixels around
    near = [slice(middle + FINE * i - half, middle + FINE * i + half + 1) for i in (-1, 0, 1)]
    ensquared = sum(image[rows, columns] for rows in near for columns in near)
    top, left = np.unravel_index(image.argmax(), image.shape)
    order, distance = rings
    encircled = np.maximum.accumulate(np.cumsum(image.ravel()[order]))
    return {"fwhm_x_px": _width(image[top], fine), "fwhm_y_px": _width(image[:, left], fine),
            "central_pixel_fraction": float(image[middle, middle]), "ensquared_3x3_fraction": float(ensquared[half, half]),
            "ensquared_3x3_worst_fraction": float(ensquared.min()),
            "effective_pixels": float(pixels.sum() ** 2 / (pixels**2).sum()),
            "asymmetry": float(np.abs(image - _turned(image, top, left)).sum() / image.sum() / 2),
            "ee80_radius_px": float(np.interp(0.8, encircled / encircled[-1], distance))} | _transfer(psf, xy_px)


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
