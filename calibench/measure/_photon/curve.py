"""The characteristic curve of one plane: each level of light above its dark, and where the plane saturates.

EMVA 1288 R4 Linear, section 6. Light is in photons where they are known, else in seconds of exposure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from .levels import Level

FITTED_FILL = 0.7  # of saturation: the range of the fits
SATURATED_SHARE = (0.001, 0.002)  # of the pixels at the largest value
VARIANCE_FALLS = 0.8  # a full well without a clipped converter shows as a variance that falls by this from its peak
SAME_EXPOSURE = 1e-6
CLEARLY_MORE = 10.0


@dataclass(frozen=True, kw_only=True)
class Darks:
    """What lies below the light: levels of dark frames, or what a map knows. correlation: (6,) of the noise at the shortest
    exposure with the neighbours at `crosstalk.STEPS`, 0 where only a map is known.

    at: exposure in s -> (mean DN, its error, variance DN^2, its error, own), own: from darks of that exposure. The errors leave
    out what darks that serve all levels have in common.
    """

    exposure_s: np.ndarray
    mean_dn: np.ndarray
    mean_error_dn: np.ndarray
    variance_dn2: np.ndarray
    variance_error_dn2: np.ndarray
    correlation: np.ndarray

    def at(self, exposure_s: float | None) -> tuple[float, float, float, float, bool]:
        """Raises BadInput where the exposure is neither among the darks nor can be interpolated."""
        known = np.isfinite(self.exposure_s)
        if exposure_s is None or not known.any():
            return float(self.mean_dn[0]), 0.0, float(self.variance_dn2[0]), float(self.variance_error_dn2[0]), False
        near = int(np.nanargmin(np.abs(self.exposure_s - exposure_s)))
        if abs(self.exposure_s[near] - exposure_s) <= SAME_EXPOSURE * exposure_s:
            own = (self.mean_dn, self.mean_error_dn, self.variance_dn2, self.variance_error_dn2)
            return *(float(values[near]) for values in own), True
        t = self.exposure_s[known]
        if len(t) < 2:
            raise BadInput(f"light of {exposure_s:g} s, but darks of {t[0]:g} s only",
                           mend="add darks of each exposure, or of several exposures")
        mean, variance = (np.polyval(np.polyfit(t, y[known], 1), exposure_s) for y in (self.mean_dn, self.variance_dn2))
        return float(mean), 0.0, float(variance), 0.0, False


def darks_of(levels: Sequence[Level]) -> Darks:
    """Dark levels in ascending exposure."""
    levels = sorted(levels, key=lambda v: -1.0 if v.exposure_s is None else v.exposure_s)
    return Darks(exposure_s=np.array([np.nan if v.exposure_s is None else v.exposure_s for v in levels]),
                 mean_dn=np.array([v.mean_dn for v in levels]), mean_error_dn=np.array([_mean_error_dn(v) for v in levels]),
                 variance_dn2=np.array([v.variance_dn2 for v in levels]),
                 variance_error_dn2=np.array([v.variance_error_dn2 for v in levels]), correlation=levels[0].correlation)


def _mean_error_dn(level: Level) -> float:
    """1-sigma of a level's mean: what the pixels' noise makes of it, or the frames' scatter where that is clearly more."""
    of_pixels, of_frames = level.variance_dn2 / level.pixels, float(np.var(level.frame_means_dn, ddof=1))
    return float(np.sqrt((of_frames if of_frames > CLEARLY_MORE * of_pixels else of_pixels) / level.count))


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Levels of light, the dimmest first, (K,) each.

    light: in `light_unit` ("photons" or "s"; "" where neither is known, then NaN). signal_dn, variance_dn2: above dark;
    variance_error_dn2: 1-sigma, without the part that all levels share. correlation: (K, 6) of the noise with the neighbours at
    `crosstalk.STEPS`, NaN where not looked for; dark_correlation: (6,) of the dark. saturation: index of the level of R4's
    rule, None where none was reached; `saturated_by` says how. own_dark: each level has darks of its own exposure.
    """

    light: np.ndarray
    light_unit: str
    mean_dn: np.ndarray
    signal_dn: np.ndarray
    signal_error_dn: np.ndarray
    variance_dn2: np.ndarray
    variance_error_dn2: np.ndarray
    noise_dn2: np.ndarray
    at_top: np.ndarray
    flicker: np.ndarray
    correlation: np.ndarray
    dark_correlation: np.ndarray
    saturation: int | None
    saturated_by: str
    top_dn: float
    own_dark: bool

    @property
    def fitted(self) -> np.ndarray:
        """(K,) bool: levels up to 70 % of saturation."""
        return self.below(FITTED_FILL)

    def below(self, fill: float, above: float = 0.0) -> np.ndarray:
        """(K,) bool: levels between these parts of saturation, by light where it is known, else by signal."""
        scale = self.light if self.light_unit else self.signal_dn
        if self.saturation is not None:
            full = scale[self.saturation]
        else:  # where the converter's end would be
            full = scale[-1] * max((self.top_dn - self.mean_dn[-1] + self.signal_dn[-1]) / self.signal_dn[-1], 1.0)
        return (scale <= fill * full) & (scale >= above * full)


def curve_of(levels: Sequence[Level], darks: Darks, white_level_dn: float) -> Curve:
    """Raises BadInput where the dark below a level is not known."""
    photons = [v.photons for v in levels]
    exposures = [v.exposure_s for v in levels]
    if None not in photons:
        light, unit = np.array(photons, float), "photons"
    elif None not in exposures and len(set(exposures)) > 1:
        light, unit = np.array(exposures, float), "s"
    else:
        light, unit = np.full(len(levels), np.nan), ""
    order = np.argsort(light if unit else [v.mean_dn for v in levels], kind="stable")
    levels, light = [levels[i] for i in order], light[order]
    below = [darks.at(v.exposure_s) for v in levels]
    dark, dark_mean_error, dark_variance, dark_error, own = (np.array(x) for x in zip(*below, strict=True))
    mean, noise, error = (np.array([getattr(v, n) for v in levels]) for n in ("mean_dn", "variance_dn2", "variance_error_dn2"))
    own_dark = bool(own.all()) and len(set(exposures)) == len(levels)
    top = max(v.top_dn for v in levels)
    at_top = np.array([v.at_top if v.top_dn == top else 0.0 for v in levels])
    saturation, how = _saturation(mean, noise, error, at_top)
    flicker = np.array([np.std(v.frame_means_dn, ddof=1) for v in levels]) / np.maximum(mean - dark, 1.0)
    return Curve(
        light=light, light_unit=unit, mean_dn=mean, signal_dn=mean - dark, variance_dn2=noise - dark_variance,
        signal_error_dn=np.hypot([_mean_error_dn(v) for v in levels], dark_mean_error), noise_dn2=noise, at_top=at_top,
        variance_error_dn2=np.hypot(error, dark_error) if own_dark else error, flicker=flicker, own_dark=own_dark,
        correlation=np.array([v.correlation for v in levels]), dark_correlation=darks.correlation, saturation=saturation,
        saturated_by=how,
        top_dn=float(max(top, white_level_dn) if saturation is None else top))


def _saturation(mean_dn: np.ndarray, noise_dn2: np.ndarray, error_dn2: np.ndarray,
                at_top: np.ndarray) -> tuple[int | None, str]:
    """Index of the saturating level and how it was found. Pixels at the top in the dimmest level too are stuck, not full."""
    least, most = SATURATED_SHARE
    share = at_top - at_top[0]
    if len(mean_dn) > 1 and share.max() >= least:
        above = np.flatnonzero(share > most)
        index = (above[0] if len(above) else len(share)) - 1
        return max(int(index), 0), f"last level with at most {100 * most:g} % of the pixels at the largest value"
    peak = int(np.argmax(noise_dn2))
    falls = noise_dn2[peak:] < VARIANCE_FALLS * noise_dn2[peak]
    if falls.any() and noise_dn2[peak] - noise_dn2[peak:].min() > 5 * error_dn2[peak]:
        return peak, "peak of the temporal variance: the pixels fill before the converter"
    return None, ""
