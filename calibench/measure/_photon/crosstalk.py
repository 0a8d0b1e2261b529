"""Charge that shows in other pixels or in the next frame: it correlates the noise and draws the gain of photon transfer down.

A pixel reads sum_k h_k q_k of its neighbourhood's charges, sum h = 1. Its temporal variance is then sum h^2 of what the
charge has, while the autocorrelation of the noise, summed over all neighbours and the pixel itself, is 1 / sum h^2: the gain K
times that sum is free of the coupling (Moore, Ning and Woo 2006, Opt. Eng. 45, 076402). Only photon noise says this: the
dark's own autocovariance (of rows that jitter, say) is taken off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .figure import Figure

if TYPE_CHECKING:
    from .curve import Curve
    from .levels import Level

STEPS = ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 0), (0, 2))  # (x, y) to each pair of neighbours; the first two are the nearest
LOOK_FURTHER = 5.0  # standard errors of the nearest neighbours' correlation from which the others are looked at
WORTH, SURE = 0.01, 5.0  # of the gain, and in standard errors: from here on the corrected gain is given
MOST = 0.25  # correlation that four neighbours sharing a charge could make
FEW_FRAMES = 8


class Crosstalk(NamedTuple):
    """correlation: of photon noise with the right and the lower neighbour. coupling_percent: of a pixel's charge that shows in
    each neighbour along x, along y, as far as it is shared evenly. gain: K without it, DN/e-; None where none is sure."""

    correlation: tuple[Figure, Figure]
    coupling_percent: tuple[Figure, Figure]
    gain: Figure


def neighbours(earlier: np.ndarray, later: np.ndarray, nearest: tuple[float, float]) -> np.ndarray:
    """(6,) correlations of the frames' difference with its neighbours at STEPS; NaN for the further ones where the nearest are
    not correlated: there is nothing to find then, and the looking costs time.

    Args:
        earlier, later: (H, W) whole DN. nearest: the correlations with the right and the lower neighbour.
    """
    out = np.full(len(STEPS), np.nan)
    out[:2] = nearest
    if np.abs(nearest).max() * np.sqrt(earlier.size) > LOOK_FURTHER:
        width = earlier.shape[1]
        d = np.subtract(later, earlier, dtype=float).ravel()
        d -= d.mean()
        for i, (x, y) in enumerate(STEPS[2:], 2):
            step = y * width + x  # pairs across the end of a row are no neighbours and add nothing but noise
            pairs = (width - abs(x)) * (d.size // width - y)
            out[i] = d[step:] @ d[:-step] / pairs / (d @ d / d.size)
    return out


def crosstalk(curve: Curve, pixels: int, gain: Figure) -> Crosstalk:
    """What the levels up to 70 % of saturation show. pixels: of a frame's plane."""
    rho, error = _of_photons(curve, pixels)
    e = float(error[0])
    nearest = 2 * abs(float(rho[:2].sum()))
    corrected = Figure(None, None, f"no significant crosstalk: the noise of neighbours is correlated by {rho[0]:+.4f} and "
                       f"{rho[1]:+.4f} +- {e:.2g}")
    if nearest > max(WORTH, SURE * 2 * np.sqrt(2) * e):
        corrected = gain._replace(reason="").times(1 + 2 * float(rho.sum()))
        corrected = corrected.widened(gain.value * 2 * float(np.linalg.norm(error)))
    return Crosstalk(tuple(Figure(float(r), e) for r in rho[:2]), _coupling(rho[:2], e), corrected)


def _of_photons(curve: Curve, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """(6,) correlations of the photon noise and their errors, 0 +- 0 where nothing was looked for: the dark's autocovariance is
    taken off, and each level counts by how little of its noise is the dark's."""
    fitted = curve.fitted
    noise, light = curve.noise_dn2[fitted, None], np.maximum(curve.variance_dn2[fitted, None], 1e-12)
    rho = (curve.correlation[fitted] * noise - np.nan_to_num(curve.dark_correlation) * (noise - light)) / light
    weight = np.where(np.isfinite(rho), (light / noise) ** 2, 0.0)
    total = weight.sum(axis=0)
    seen = total > 0
    mean = np.nansum(weight * np.nan_to_num(rho), axis=0) / np.where(seen, total, 1.0)
    return mean, np.where(seen, 1 / np.sqrt(np.where(seen, total, 1.0) * pixels), 0.0)


def _coupling(rho: np.ndarray, error: float) -> tuple[Figure, Figure]:
    """Coupling (x, y) in % from the correlations: rho_x = 2 a_x h0 / (h0^2 + 2 a_x^2 + 2 a_y^2), h0 = 1 - 2 a_x - 2 a_y."""
    if np.abs(rho).max() > MOST:
        none = Figure(None, None, "the noise is correlated by more than neighbours that share charge could make it: processed?")
        return none, none
    shared = np.zeros(2)
    for _ in range(50):
        rest = 1 - 2 * shared.sum()
        shared = rho * (rest**2 + 2 * shared @ shared) / (2 * rest)
    return tuple(Figure(float(100 * a), 50 * error) for a in shared)


def lag(level: Level | None) -> Figure:
    """Correlation of the noise of consecutive frames: what the variance of a stack has more than that of its first two frames.

    Image lag carries a part of each charge into the next frame; the gain from pairs of frames is low by about as much.
    """
    if level is None or level.count < FEW_FRAMES:
        return Figure(None, None, f"needs a lit stack of {FEW_FRAMES} frames")
    return Figure(1 - level.pair_variance_dn2 / level.variance_dn2, float(np.sqrt(2 / level.pixels)))
