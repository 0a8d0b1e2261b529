"""The dark ladder: stacks by exposure, and the straight line through them, pixel by pixel.

Least squares over exposures with one weight an exposure (frames / typical variance), so that offset and rate of all
pixels are weighted sums of the mean images; their errors follow from each pixel's own temporal variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ._defects import core_sigma
from ._stack import Accumulator, Series

MAX_EXPOSURE_S = 86400.0
MAX_RATE_E_PER_S = 1e5
MIN_TIME_TO_FILL_S = 0.1
QUANTISATION_DN2 = 1 / 12  # variance of rounding to whole DN (EMVA 1288)


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Dark stacks in ascending exposure and the line through them.

    exposure_s: (K,), or None where no frame says it (then K is 1). offset_dn, offset_variance_dn2, and rate_dn_per_s,
    rate_variance (H, W); the rate is None where there are fewer than two exposures, and the offset then holds the dark signal.
    level_rate, level_offset: (value, uncertainty) of the line through the mean levels.
    noise_known: some exposure has two frames or more; else the noise is taken from the scatter over the image.
    """

    exposure_s: tuple[float, ...] | None
    series: tuple[Series, ...]
    variance_dn2: tuple[np.ndarray, ...]
    offset_dn: np.ndarray
    offset_variance_dn2: np.ndarray
    rate_dn_per_s: np.ndarray | None
    rate_variance: np.ndarray | None
    level_offset: tuple[float, float]
    level_rate: tuple[float, float] | None
    noise_known: bool

    def at(self, exposure_s: float | None) -> tuple[np.ndarray, np.ndarray, str]:
        """Dark image (H, W), its variance, and how it was had: the stack of that exposure, or the line.

        Raises:
            BadInput: the exposure is neither in the ladder nor can the ladder be interpolated.
        """
        for i, t in enumerate(self.exposure_s or ()):
            if exposure_s is not None and abs(t - exposure_s) <= 1e-6 * t:
                series = self.series[i]
                return series.stack.mean_dn, self.variance_dn2[i] / series.stack.count, f"darks of {t:g} s"
        if self.exposure_s is None or exposure_s is None:
            return self.offset_dn, self.offset_variance_dn2, "darks taken as matching: exposure unknown"
        if self.rate_dn_per_s is None:
            raise BadInput(f"flats of {exposure_s:g} s, but darks of {self.exposure_s[0]:g} s only",
                           mend="add darks of the flats' exposure, or of several exposures")
        return (self.offset_dn + exposure_s * self.rate_dn_per_s, self.offset_variance_dn2 + exposure_s**2 * self.rate_variance,
                f"dark ladder interpolated to {exposure_s:g} s")


def fit(stacks: dict[float | None, Accumulator], white_level_dn: float, gain_dn_per_e: float) -> Ladder:
    """The ladder from accumulated darks, keyed by exposure in s (None: unknown, then it is the only key).

    Args:
        gain_dn_per_e: NaN where unknown; used only to tell an absurd rate.

    Raises:
        BadInput: exposures or the rate are absurd, as they are when the time unit is wrong.
    """
    exposures = tuple(sorted(stacks)) if None not in stacks else None
    series = tuple(stacks[t].series() for t in exposures or (None,))
    known = [s for s in series if s.freedom]
    variance = tuple(_variance(s, known) for s in series)
    if exposures and exposures[-1] > MAX_EXPOSURE_S:
        raise BadInput(f"an exposure of {exposures[-1]:g} s is longer than a day", mend="give exposures in seconds")
    common = {"series": series, "variance_dn2": variance, "exposure_s": exposures, "noise_known": bool(known)}
    if exposures is None or len(exposures) < 2:
        one = series[0]
        return Ladder(**common, offset_dn=one.stack.mean_dn, offset_variance_dn2=variance[0] / one.stack.count,
                      rate_dn_per_s=None, rate_variance=None, level_rate=None, level_offset=(
                          float(one.levels_dn.mean()), _level_error(one, variance[0])))
    t = np.array(exposures)
    per_mean = [v / s.stack.count for v, s in zip(variance, series, strict=True)]
    to_offset, to_rate = _line(t, np.array([max(float(np.median(v)), 1e-12) for v in per_mean]))
    level = np.array([s.levels_dn.mean() for s in series])
    error = np.array([_level_error(s, v) for s, v in zip(series, variance, strict=True)])
    level_offset, level_rate = _level_line(t, level, error)
    _check_rate(level_rate[0], white_level_dn, gain_dn_per_e)
    means = [s.stack.mean_dn for s in series]
    return Ladder(**common, level_offset=level_offset, level_rate=level_rate,
                  offset_dn=_combine(to_offset, means), offset_variance_dn2=_combine(to_offset**2, per_mean),
                  rate_dn_per_s=_combine(to_rate, means), rate_variance=_combine(to_rate**2, per_mean))


def _variance(series: Series, known: list[Series]) -> np.ndarray:
    """Temporal variance (H, W) of a single frame: own, or of the stacks that have one, or an upper limit from the image."""
    if series.freedom:
        return series.steady_variance_dn2
    if known:
        return known[0].steady_variance_dn2
    mean = series.stack.mean_dn
    return np.full(mean.shape, float(np.median(core_sigma(mean - np.median(mean), None))) ** 2)


def _line(t: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (K,), (K,) that make offset and slope of the least-squares line out of K values with these variances."""
    design = np.stack([np.ones_like(t), t / t.max()])
    weighted = design / variance
    to_offset, to_slope = np.linalg.solve(weighted @ design.T, weighted)
    return to_offset, to_slope / t.max()


def _combine(weights: np.ndarray, images: list[np.ndarray]) -> np.ndarray:
    return sum(w * image for w, image in zip(weights, images, strict=True))


def _level_error(series: Series, variance: np.ndarray) -> float:
    """1-sigma of the mean level: the scatter of the frames' levels, at least what the pixels' noise makes of it."""
    n = series.stack.count
    pixels = float(np.sqrt(np.mean(variance) / (n * variance.size)))
    frames = float(np.std(series.levels_dn, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
    return max(pixels, frames, 1e-9)


def _level_line(t: np.ndarray, level: np.ndarray, error: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """(offset, uncertainty), (rate, uncertainty); errors are widened where the levels scatter more about the line."""
    to_offset, to_rate = _line(t, error**2)
    offset, rate = float(to_offset @ level), float(to_rate @ level)
    freedom = len(t) - 2
    chi = np.sqrt(np.sum(((level - offset - rate * t) / error) ** 2) / freedom) if freedom else 1.0
    wider = max(1.0, float(chi))
    return ((offset, wider * float(np.linalg.norm(to_offset * error))), (rate, wider * float(np.linalg.norm(to_rate * error))))


def _check_rate(rate_dn_per_s: float, white_level_dn: float, gain_dn_per_e: float) -> None:
    limit = MAX_RATE_E_PER_S * gain_dn_per_e if np.isfinite(gain_dn_per_e) else white_level_dn / MIN_TIME_TO_FILL_S
    if abs(rate_dn_per_s) > limit:
        unknown = not np.isfinite(gain_dn_per_e)
        figure = f"{rate_dn_per_s:.3g} DN/s" if unknown else f"{rate_dn_per_s / gain_dn_per_e:.3g} e-/s"
        raise BadInput(f"a mean dark rate of {figure} is absurd", mend="give exposures in seconds; were frames of different "
                       "exposure or temperature mixed up?")
