"""Straight lines of photon transfer: the gain from how temporal variance grows with the mean (EMVA 1288 R4 Linear, 6.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_FILL = 0.7  # of saturation: beyond it the variance shrinks
MIN_LEVELS_FOR_OFFSET = 3
BEYOND_CHANCE = 3.0  # standard deviations of chi^2 from which the levels do not lie on the line


@dataclass(frozen=True, kw_only=True)
class TransferPoint:
    """One light level: mean above dark, temporal variance above dark's, and the 1-sigma error of the latter."""

    signal_dn: float
    variance_dn2: float
    variance_uncertainty_dn2: float


@dataclass(frozen=True, kw_only=True)
class Line:
    """y = slope x + offset with 1-sigma errors. chi2: of the weighted fit over its degrees of freedom; 0 where there are none.
    weighted: whether the levels count by their errors (they lie on the line) or alike."""

    slope: float
    slope_error: float
    offset: float
    offset_error: float
    chi2: float
    weighted: bool


def line(x: np.ndarray, y: np.ndarray, error: np.ndarray, *, free_offset: bool = True) -> Line:
    """Least-squares line.

    By weights 1/error^2 where the points lie on a line within their errors: then this is the most exact. Where they do not
    (a response that bends, a lamp that flickers), weights would let the dimmest levels decide; every level counts alike
    then, as the standard has it, and the scatter about the line sets the error.
    """
    design = np.stack([x, np.ones_like(x)], -1)[:, : 1 + free_offset]
    freedom = len(x) - design.shape[1]
    weighted = np.linalg.pinv(design / error[:, None]) / error
    residual = y - design @ (weighted @ y)
    chi2 = float(np.sum((residual / error) ** 2) / freedom) if freedom else 0.0
    alike = freedom > 0 and chi2 > 1 + BEYOND_CHANCE * np.sqrt(2 / freedom)
    solver = np.linalg.pinv(design) if alike else weighted
    found = solver @ y
    if alike:
        error = np.maximum(error, np.sqrt(np.sum((y - design @ found) ** 2) / freedom))
    errors = np.linalg.norm(solver * error, axis=1)
    return Line(slope=float(found[0]), slope_error=float(errors[0]), offset=float(found[1]) if free_offset else 0.0,
                offset_error=float(errors[1]) if free_offset else 0.0, chi2=chi2, weighted=not alike)


def variance_line(x: np.ndarray, y: np.ndarray, error: np.ndarray, total: np.ndarray) -> Line:
    """Line through variances y, which are parts of the measured `total`.

    The error of a variance is as large as the variance: one that is low by chance would weigh more and draw the line down. The
    errors are therefore scaled to what a first line expects.
    """
    first = line(x, y, error)
    expected = first.slope * x + first.offset + total - y
    return line(x, y, error * np.clip(expected / np.maximum(total, 1e-12), 0.5, 2.0))


def gain(points: list[TransferPoint]) -> tuple[float, float, str]:
    """Gain in DN/e-, its 1-sigma uncertainty, and how it was had.

    From three levels on the slope of the line with free offset (release 4); fewer give the ratio.
    """
    signal, variance, error = (np.array([getattr(p, f) for p in points]) for f in TransferPoint.__dataclass_fields__)
    free = len(points) >= MIN_LEVELS_FOR_OFFSET
    found = line(signal, variance, np.maximum(error, 1e-12), free_offset=free)
    how = f"slope over {len(points)} levels, free offset" if free else f"ratio at {len(points)} level{'s'[: len(points) - 1]}"
    return found.slope, found.slope_error, how
