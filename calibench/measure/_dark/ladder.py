"""The dark ladder: levels by exposure, and the straight line through them, pixel by pixel.

Least squares over exposures with one weight an exposure (frames / typical variance), so that offset and rate of all
pixels are weighted sums of the mean images; their errors follow from each pixel's own temporal variance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .._defects import core_sigma, typical
from .._transfer import BEYOND_CHANCE
from .levels import DarkLevel
from .limits import check_exposure, check_rate

CLEARLY_MORE = 3.0  # times the error of the pixels' noise


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Dark levels of one temperature in ascending exposure and the line through them. Images are (H, W) float32.

    exposure_s: (K,), or None where no frame says it (then K is 1). variance_dn2: temporal variance of one frame at each level.
    offset_dn and rate_dn_per_s; the rate is None where there are fewer than two exposures, and the offset then holds the dark
    signal. to_offset, to_rate: (K,) weights of the mean images that make them.
    level_rate, level_offset: (value, uncertainty) of the line through the mean levels.
    noise_known: some exposure has two frames or more; else the noise is taken from the scatter over the image.
    """

    exposure_s: tuple[float, ...] | None
    levels: tuple[DarkLevel, ...]
    variance_dn2: tuple[np.ndarray, ...]
    offset_dn: np.ndarray
    rate_dn_per_s: np.ndarray | None
    to_offset: np.ndarray
    to_rate: np.ndarray | None
    level_offset: tuple[float, float]
    level_rate: tuple[float, float] | None
    noise_known: bool

    @property
    def temperature_c(self) -> float | None:
        """Mean temperature of the levels that state one."""
        stated = [level.temperature_c for level in self.levels if level.temperature_c is not None]
        return float(np.mean(stated)) if stated else None

    @property
    def offset_variance_dn2(self) -> np.ndarray:
        """(H, W), made anew at each call."""
        return self._variance_by(self.to_offset)

    @property
    def rate_variance(self) -> np.ndarray | None:
        """(H, W), made anew at each call."""
        return None if self.to_rate is None else self._variance_by(self.to_rate)

    def departures(self) -> Iterator[tuple[float, np.ndarray, np.ndarray, int]]:
        """For each exposure: (exposure in s, mean image minus line (H, W), variance of one frame (H, W), number of frames).
        Needs a rate."""
        for t, level, variance in zip(self.exposure_s, self.levels, self.variance_dn2, strict=True):
            line = np.float32(t) * self.rate_dn_per_s
            line += self.offset_dn
            yield t, np.subtract(level.mean_dn, line, out=line), variance, level.count

    def _variance_by(self, weights: np.ndarray) -> np.ndarray:
        return _combine(weights**2 / [level.count for level in self.levels], self.variance_dn2)


def fit(levels: Sequence[DarkLevel], white_level_dn: float, gain_dn_per_e: float) -> Ladder:
    """The ladder of the levels of one temperature, in ascending exposure; where the exposure is unknown there is one level.

    Args:
        gain_dn_per_e: NaN where unknown; used only to tell an absurd rate.

    Raises:
        BadInput: exposures or the rate are absurd, as they are when the time unit is wrong.
    """
    exposures = None if levels[0].exposure_s is None else tuple(level.exposure_s for level in levels)
    known = [level for level in levels if level.freedom]
    variance = tuple(_variance(level, known) for level in levels)
    check_exposure(exposures[-1] if exposures else 0.0)
    common = {"levels": tuple(levels), "variance_dn2": variance, "exposure_s": exposures, "noise_known": bool(known)}
    if exposures is None or len(exposures) < 2:
        one = levels[0]
        return Ladder(**common, offset_dn=one.mean_dn, rate_dn_per_s=None, to_offset=np.ones(1), to_rate=None,
                      level_rate=None, level_offset=(
                          float(one.levels_dn.mean()), _level_error(one, variance[0])))
    t = np.array(exposures)
    counts = np.array([level.count for level in levels])
    to_offset, to_rate = _line(t, np.array([max(typical(v), 1e-12) for v in variance]) / counts)
    level = np.array([one.levels_dn.mean() for one in levels])
    error = np.array([_level_error(one, v) for one, v in zip(levels, variance, strict=True)])
    level_offset, level_rate = _level_line(t, level, error)
    check_rate(level_rate[0], exposures[-1], white_level_dn, gain_dn_per_e)
    means = [one.mean_dn for one in levels]
    return Ladder(**common, level_offset=level_offset, level_rate=level_rate, to_offset=to_offset, to_rate=to_rate,
                  offset_dn=_combine(to_offset, means), rate_dn_per_s=_combine(to_rate, means))


def _variance(level: DarkLevel, known: list[DarkLevel]) -> np.ndarray:
    """Temporal variance (H, W) of a single frame: own, or of the levels that have one, or an upper limit from the image."""
    if level.freedom:
        return level.variance_dn2
    if known:
        return known[0].variance_dn2
    return most_variance_dn2(level.mean_dn)


def most_variance_dn2(mean_dn: np.ndarray) -> np.ndarray:
    """(H, W) upper limit of the temporal variance where no frame is repeated: from the scatter over the image."""
    return np.full(mean_dn.shape, float(np.median(core_sigma(mean_dn - np.median(mean_dn), None))) ** 2, np.float32)


def _line(t: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (K,), (K,) that make offset and slope of the least-squares line out of K values with these variances."""
    design = np.stack([np.ones_like(t), t / t.max()])
    weighted = design / variance
    to_offset, to_slope = np.linalg.solve(weighted @ design.T, weighted)
    return to_offset, to_slope / t.max()


def _combine(weights: np.ndarray, images: Sequence[np.ndarray]) -> np.ndarray:
    total = np.float32(weights[0]) * images[0]
    for weight, image in zip(weights[1:], images[1:], strict=True):
        total += np.float32(weight) * image
    return total


def _level_error(level: DarkLevel, variance: np.ndarray) -> float:
    """1-sigma of the mean level: what the pixels' noise makes of it, or the scatter of the frames' levels where that is clearly
    more. The larger of the two would be too large on average: the scatter of few frames is mostly chance."""
    n = level.count
    pixels = float(np.sqrt(np.mean(variance) / (n * variance.size)))
    frames = float(np.std(level.levels_dn, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
    return max(frames if frames > CLEARLY_MORE * pixels else pixels, 1e-9)


def _level_line(t: np.ndarray, level: np.ndarray, error: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """(offset, uncertainty), (rate, uncertainty); errors are widened where the levels scatter more about the line than chance
    lets them."""
    to_offset, to_rate = _line(t, error**2)
    offset, rate = float(to_offset @ level), float(to_rate @ level)
    freedom = len(t) - 2
    chi2 = np.sum(((level - offset - rate * t) / error) ** 2) / freedom if freedom else 1.0
    wider = float(np.sqrt(chi2)) if chi2 > 1 + BEYOND_CHANCE * np.sqrt(2 / max(freedom, 1)) else 1.0
    return ((offset, wider * float(np.linalg.norm(to_offset * error))), (rate, wider * float(np.linalg.norm(to_rate * error))))
