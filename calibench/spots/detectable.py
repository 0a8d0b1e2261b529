"""The faintest star that a camera detects: by the thesis's criterion, by the matched filter, and as a magnitude.

A star of F electrons has in pixel k of its window F f_k(phase), f the pixel-integrated PSF. With noise sigma a pixel (read
noise, sky, dark charge and rounding together) and threshold T = k sigma:

    any four pixels above T:    F = T / (fourth largest f)
    the plus (peak and its four sides) above T:    F = T / (fifth largest of the plus)
    a tenth pixel above T (the thesis's ceiling of nine, with a fixed threshold):    F = T / (tenth largest f)
    matched filter above T:     F = T / sqrt(sum f^2)

Each is the flux whose mean is on the threshold (found every other time). The limiting magnitude follows from a zero point, the
magnitude that gives one electron a second: m = zero point - 2.5 log10(F / exposure).
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

CRITERIA = ("four_pixels", "plus", "ten_pixels", "matched")
WINDOW_PX = 9
PHASES = 41  # a side; phases over the pixel


def pixel_fractions(sigma_px: tuple[float, float], phase_px: np.ndarray) -> np.ndarray:
    """Fractions (N, WINDOW_PX, WINDOW_PX), [y, x], of a Gaussian's light in the pixels about the one that holds its centre.

    sigma_px: along x and y. phase_px: (N, 2), centre of the spot from the centre of that pixel.
    """
    edges = np.arange(WINDOW_PX + 1) - WINDOW_PX / 2
    x, y = (np.diff(erf((edges - phase_px[:, axis, None]) / (np.sqrt(2) * sigma_px[axis])), axis=1) / 2 for axis in (0, 1))
    return y[:, :, None] * x[:, None, :]


def least_flux(fractions: np.ndarray, threshold: float, criterion: str) -> np.ndarray:
    """Flux (N,) at which stars of pixel fractions (N, R, C) meet the criterion, in the threshold's unit; infinite for never.

    Raises:
        ValueError: a criterion that is none of CRITERIA.
    """
    flat = fractions.reshape(len(fractions), -1)
    if criterion == "matched":
        share = np.sqrt((flat**2).sum(1))
    elif criterion == "plus":
        row, column = np.unravel_index(flat.argmax(1), fractions.shape[1:])
        framed = np.pad(fractions, ((0, 0), (1, 1), (1, 1)))  # a peak on the rim has a dark side
        share = np.min([framed[np.arange(len(flat)), row + 1 + dy, column + 1 + dx]
                        for dy, dx in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0))], axis=0)
    elif criterion in CRITERIA:
        rank = -4 if criterion == "four_pixels" else -10
        share = np.partition(flat, rank, axis=1)[:, rank]
    else:
        raise ValueError(f"criterion '{criterion}' is none of {', '.join(CRITERIA)}")
    return np.divide(threshold, share, out=np.full(len(flat), np.inf), where=share > 0)


def detectable_flux_e(sigma_px: tuple[float, float], noise_e: float, k_sigma: float, criterion: str) -> dict[str, float]:
    """Least flux, e-, of a star of Gaussian sigma (x, y) px in pixels of noise_e: {centred, median, worst} over pixel phases.

    Raises:
        ValueError: a criterion that is none of CRITERIA, or a width, noise or threshold that is not positive.
    """
    if not (min(sigma_px) > 0 and noise_e > 0 and k_sigma > 0):
        raise ValueError("width, noise and threshold must be positive")
    steps = np.linspace(-0.5, 0.5, PHASES)  # an odd number: the middle one is the centre of the pixel
    phases = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    flux = least_flux(pixel_fractions(sigma_px, phases), k_sigma * noise_e, criterion)
    return {"centred": float(flux[len(flux) // 2]), "median": float(np.median(flux)), "worst": float(flux.max())}


def limiting_magnitude(flux_e: float, exposure_s: float, zero_point_mag: float) -> float:
    """Magnitude of a star that gives flux_e in exposure_s; zero_point_mag: the magnitude that gives one electron a second."""
    return float(zero_point_mag - 2.5 * np.log10(flux_e / exposure_s))
