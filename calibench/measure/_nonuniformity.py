"""Spatial nonuniformity of a mean image: as it is, after the release 4 high-pass, and of its robust core.

EMVA 1288 release 4 Linear, 8: the variance of the mean of L frames holds sigma^2/L of temporal noise, which is subtracted;
the high-pass (8.1) subtracts the image smoothed by a 7x7 box, an 11x11 box and a 3x3 binomial. It passes only
NOISE_GAIN of white noise, so only that part of sigma^2/L may be subtracted after it. Of noise in the means of whole rows or
columns the filter sees one dimension only and passes LINE_NOISE_GAIN.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ._quantiles import quantiles
from .kernels import rest_moments

BINOMIAL = np.array([0.25, 0.5, 0.25])
NEGATIVE = "negative variance estimate {:.3g} {}: given as 0, the uncertainty is an upper limit of 1 sigma"
IQR_EFFICIENCY = 0.37  # information of the interquartile range against the sample variance, of normal values
KINDS = {"raw": "no high-pass, all pixels", "1288": "EMVA 1288 R4 Linear 8, high-passed, all pixels",
         "core": "high-passed, interquartile range"}


def _noise_gain(dimensions: int) -> tuple[float, float]:
    """Variance of filtered white noise over its variance: mean of g^2, g = 1 - H the filter's transfer function. With it how
    much more that variance scatters than one of as many independent values, because neighbours are correlated:
    mean of g^4 / (mean of g^2)^2."""
    line = np.zeros(256)
    line[:19] = np.convolve(np.convolve(np.full(7, 1 / 7), np.full(11, 1 / 11)), BINOMIAL)
    smooth = np.fft.fft(np.roll(line, -9)).real
    passed = (1 - (smooth if dimensions == 1 else np.outer(smooth, smooth))) ** 2
    return float(passed.mean()), float(np.mean(passed**2) / passed.mean() ** 2)


(NOISE_GAIN, WIDER), (LINE_NOISE_GAIN, LINE_WIDER) = _noise_gain(2), _noise_gain(1)  # 0.98850, 1.009; 0.88906, 1.111


@dataclass(frozen=True, kw_only=True)
class Spatial:
    """Standard deviation over the pixels with the temporal noise taken off; a negative variance gives 0 and keeps its sign."""

    sd: float
    uncertainty: float
    signed_variance: float


@dataclass(frozen=True, kw_only=True)
class Parts:
    """The whole nonuniformity and its split into rows, columns and what is left to the pixels (release 4, 8.1)."""

    total: Spatial
    row: Spatial
    column: Spatial
    pixel: Spatial


def high_pass(image: np.ndarray) -> np.ndarray:
    """Image (H, W) minus its smoothed self (release 4, 8.1); borders reflected."""
    smooth = cv2.blur(image, (7, 7), borderType=cv2.BORDER_REFLECT)
    smooth = cv2.blur(smooth, (11, 11), borderType=cv2.BORDER_REFLECT)
    smooth = cv2.sepFilter2D(smooth, -1, BINOMIAL, BINOMIAL, borderType=cv2.BORDER_REFLECT)
    return np.subtract(image, smooth, out=smooth)


def spatial_core(filtered: np.ndarray, temporal_variance_of_mean: float, of_all: Parts) -> Spatial:
    """The bulk of the pixels after `high_pass`: scale from the interquartile range, so that few defects do not carry it.

    of_all: the split of the same image, for the errors of rows and columns, of which there are few.
    """
    low, high = quantiles(filtered, (0.25, 0.75))
    measured = ((high - low) / 1.34898) ** 2
    of_pixels = measured * np.sqrt(2 * WIDER / (filtered.size * IQR_EFFICIENCY))
    return _spatial(measured - NOISE_GAIN * temporal_variance_of_mean,
                    float(np.linalg.norm([of_pixels, _error(of_all.row), _error(of_all.column)])))


def of_each_kind(mean: np.ndarray, temporal_variance_of_mean: float) -> dict[str, Spatial]:
    """The nonuniformity of a mean image by KINDS, filtered once."""
    filtered, t = high_pass(mean), temporal_variance_of_mean
    passed = split(filtered, t, filtered=True)
    return {"raw": split(mean, t, filtered=False).total, "1288": passed.total, "core": spatial_core(filtered, t, passed)}


def split(image: np.ndarray, temporal_variance_of_mean: float, *, filtered: bool) -> Parts:
    """Nonuniformity of a mean image (H, W), as it is or after `high_pass`, with the temporal noise taken off each part.

    Rows and columns follow from the variances of the row and the column means, exactly: a column mean holds 1/H of the
    pixels' variance too, and so on (release 4, 8.1).
    """
    h, w = image.shape
    image = np.ascontiguousarray(image, np.float32).view()
    image.flags.writeable = False  # one compiled form serves all
    whole, line, wider, line_wider = (NOISE_GAIN, LINE_NOISE_GAIN, WIDER, LINE_WIDER) if filtered else (1.0,) * 4
    t = temporal_variance_of_mean
    column_means, row_means = (cv2.reduce(image, axis, cv2.REDUCE_AVG, dtype=cv2.CV_64F).ravel() for axis in (0, 1))
    columns, rows = float(np.var(column_means)), float(np.var(row_means))
    second, fourth = (total / (h * w) for total in rest_moments(image, column_means - column_means.mean(), row_means))
    s2 = second + columns + rows - whole * t
    of_columns, of_rows = columns - line * t / h, rows - line * t / w
    rest = h * w - h - w
    column = ((h * w - h) * of_columns - w * (s2 - of_rows)) / rest
    row = ((h * w - w) * of_rows - h * (s2 - of_columns)) / rest
    pixel = h * w * (s2 - of_columns - of_rows) / rest
    column_error, row_error = columns * np.sqrt(2 * line_wider / (w - 1)), rows * np.sqrt(2 * line_wider / (h - 1))
    lost = (1 - 1 / h) * (1 - 1 / w)  # with the means, the image has lost as much of its pixels' variance
    # by the fourth moment: a few hot pixels make it large
    pixel_error = float(np.sqrt(max(fourth - second**2, 0.0) / (h * w) * wider / lost)) / lost
    return Parts(total=_spatial(s2, float(np.sqrt(pixel_error**2 + column_error**2 + row_error**2))),
                 row=_spatial(row, row_error), column=_spatial(column, column_error), pixel=_spatial(pixel, pixel_error))


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
