"""Spatial nonuniformity of a mean image: as it is, after the release 4 high-pass, and of its robust core.

EMVA 1288 release 4 Linear, 8: the variance of the mean of L frames holds sigma^2/L of temporal noise, which is subtracted;
the high-pass (8.1) subtracts the image smoothed by a 7x7 box, an 11x11 box and a 3x3 binomial. It passes only
NOISE_GAIN of white noise, so only that part of sigma^2/L may be subtracted after it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

BINOMIAL = np.array([0.25, 0.5, 0.25])


def _noise_gain() -> float:
    """Variance of filtered white noise over its variance: 1 - 2 h(0) + sum h^2, for the filter's impulse response."""
    line = np.convolve(np.convolve(np.full(7, 1 / 7), np.full(11, 1 / 11)), BINOMIAL)
    response = -np.outer(line, line)
    response[len(line) // 2, len(line) // 2] += 1
    return float(np.sum(response**2))


NOISE_GAIN = _noise_gain()  # 0.98850


@dataclass(frozen=True, kw_only=True)
class Spatial:
    """Standard deviation over the pixels with the temporal noise taken off; a negative variance gives 0 and keeps its sign."""

    sd: float
    uncertainty: float
    signed_variance: float


def high_pass(image: np.ndarray) -> np.ndarray:
    """Image (H, W) minus its smoothed self (release 4, 8.1); borders reflected."""
    smooth = cv2.blur(image, (7, 7), borderType=cv2.BORDER_REFLECT)
    smooth = cv2.blur(smooth, (11, 11), borderType=cv2.BORDER_REFLECT)
    return image - cv2.sepFilter2D(smooth, -1, BINOMIAL, BINOMIAL, borderType=cv2.BORDER_REFLECT)


def spatial_raw(mean: np.ndarray, temporal_variance_of_mean: float) -> Spatial:
    """All pixels, no filter."""
    return _corrected(float(np.var(mean, ddof=1)), temporal_variance_of_mean, mean.size)


def spatial_1288(mean: np.ndarray, temporal_variance_of_mean: float) -> Spatial:
    """All pixels, high-passed (release 4)."""
    return _corrected(float(np.var(high_pass(mean), ddof=1)), NOISE_GAIN * temporal_variance_of_mean, mean.size)


def spatial_core(mean: np.ndarray, temporal_variance_of_mean: float) -> Spatial:
    """The bulk of the pixels: high-passed, scale from the interquartile range, so that few defects do not carry it."""
    low, high = np.percentile(high_pass(mean), (25, 75))
    sigma = float(high - low) / 1.34898
    return _corrected(sigma**2, NOISE_GAIN * temporal_variance_of_mean, mean.size, efficiency=0.37)


def _corrected(measured: float, temporal: float, pixels: int, efficiency: float = 1.0) -> Spatial:
    """Efficiency: information of the estimator against the sample variance (Gaussian; 0.37 for the interquartile range)."""
    return _spatial(measured - temporal, measured * np.sqrt(2 / (pixels * efficiency)))


def _spatial(variance: float, error: float) -> Spatial:
    """From a variance and its 1-sigma error."""
    sd = float(np.sqrt(max(variance, 0.0)))
    return Spatial(sd=sd, uncertainty=float(error / (2 * sd) if sd > 0 else np.sqrt(error)), signed_variance=float(variance))


def _error(part: Spatial) -> float:
    """1-sigma error of the variance."""
    return 2 * part.sd * part.uncertainty if part.sd > 0 else part.uncertainty**2


def difference(bright: Spatial, dark: Spatial, scale: float) -> Spatial:
    """sqrt(bright^2 - dark^2) / scale, as PRNU1288 has it (release 4 Linear, table 2)."""
    error = np.hypot(_error(bright), _error(dark))
    return _spatial((bright.signed_variance - dark.signed_variance) / scale**2, float(error) / scale**2)


def pooled(parts: list[Spatial]) -> Spatial:
    """Mean variance of parts of equal size."""
    n = len(parts)
    return _spatial(sum(p.signed_variance for p in parts) / n, float(np.sqrt(sum(_error(p) ** 2 for p in parts))) / n)
