"""The dark below flats of any exposure, from darks of which few images are kept.

Of each level its figures are kept, of those with most frames the mean image as well. The line through all levels, each weighted
by its frames, follows pixel by pixel from two sums of the mean images, however many exposures there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from ...records import CalibrationMap, Frame
from .darkness import check_light
from .ladder import most_variance_dn2
from .levels import DarkLevel
from .limits import check_exposure, check_rate

KEPT_BYTES = 60_000_000  # of mean images; at least one is kept
SAME_EXPOSURE = 1e-6


@dataclass(frozen=True, kw_only=True)
class DarkFigures:
    """Of one level: mean over its frames and pixels, temporal variance of one frame (None: a single frame)."""

    exposure_s: float | None
    count: int
    level_dn: float
    variance_dn2: float | None


class DarkBelow:
    """Takes the dark levels of one temperature one by one."""

    def __init__(self) -> None:
        self.levels: list[DarkFigures] = []
        self._kept: list[tuple[DarkFigures, np.ndarray]] = []
        self._sum: np.ndarray | None = None  # of frames times mean image
        self._sum_t: np.ndarray | None = None  # of exposure times that
        self._noise: np.ndarray | None = None  # degrees of freedom times variance
        self._freedom = 0

    def take(self, level: DarkLevel) -> None:
        """Add a level; one of an exposure that was there before counts as one more."""
        figures = DarkFigures(exposure_s=level.exposure_s, count=level.count, level_dn=float(level.levels_dn.mean()),
                              variance_dn2=float(np.mean(level.variance_dn2)) if level.freedom else None)
        self.levels.append(figures)
        self._kept = sorted([*self._kept, (figures, level.mean_dn)], key=lambda kept: -kept[0].count)
        del self._kept[max(1, KEPT_BYTES // level.mean_dn.nbytes):]
        if self._sum is None:
            self._sum, self._sum_t, self._noise = (np.zeros(level.mean_dn.shape, np.float32) for _ in range(3))
        weighted = level.mean_dn * np.float32(level.count)
        self._sum += weighted
        weighted *= np.float32(level.exposure_s or 0.0)
        self._sum_t += weighted
        if level.freedom:
            self._noise += level.variance_dn2 * np.float32(level.freedom)
            self._freedom += level.freedom

    def check(self, white_level_dn: float, bayer_pattern: str | None) -> None:
        """Raises BadInput where the darks are lit, or exposures or rate absurd, as they are when the time unit is wrong."""
        check_exposure(max(self._t))
        if np.ptp(self._t) > 0:
            rate_dn_per_s, longest_s = self._line_dn(1.0) - self._line_dn(0.0), max(self._t)
            check_rate(rate_dn_per_s, longest_s, white_level_dn, np.nan)
            check_light(rate_dn_per_s * longest_s, white_level_dn, self._rate, bayer_pattern)

    @property
    def pixels(self) -> int:
        return self._sum.size

    @property
    def noise_known(self) -> bool:
        """Whether some level has two frames or more."""
        return self._freedom > 0

    def noise_dn2(self, exposure_s: float | None) -> float:
        """Mean temporal variance of one frame at the exposure nearest to this one."""
        known = [one for one in self.levels if one.variance_dn2 is not None]
        return min(known, key=lambda one: abs((one.exposure_s or 0.0) - (exposure_s or 0.0))).variance_dn2

    def level_dn(self, exposure_s: float | None) -> float:
        """Mean dark level at an exposure. Raises BadInput where `image` does."""
        own = [one for one in self.levels if _same(one.exposure_s, exposure_s)]
        if own:
            return float(np.average([one.level_dn for one in own], weights=[one.count for one in own]))
        self._how(exposure_s)
        return self._line_dn(exposure_s or 0.0)

    def image(self, exposure_s: float | None) -> tuple[np.ndarray, np.ndarray, str]:
        """Dark image (H, W), its variance, and how it was had: the stack of that exposure, or the line.

        Raises:
            BadInput: the exposure is not among the darks', and they have one exposure only.
        """
        for figures, mean in self._kept:
            if _same(figures.exposure_s, exposure_s):
                return mean, self._variance() / np.float32(figures.count), f"darks of {figures.exposure_s:g} s"
        how = self._how(exposure_s)
        a, b = self._weights(exposure_s or 0.0)
        part = float(self._n @ (a + b * self._t) ** 2)
        return np.float32(a) * self._sum + np.float32(b) * self._sum_t, self._variance() * np.float32(part), how

    @property
    def _n(self) -> np.ndarray:
        return np.array([one.count for one in self.levels], float)

    @property
    def _t(self) -> np.ndarray:
        return np.array([one.exposure_s or 0.0 for one in self.levels])

    def _how(self, exposure_s: float | None) -> str:
        if exposure_s is None or self.levels[0].exposure_s is None:
            return "darks taken as matching: exposure unknown"
        if np.ptp(self._t) == 0 and not _same(self._t[0], exposure_s):
            raise BadInput(f"flats of {exposure_s:g} s, but darks of {self._t[0]:g} s only",
                           mend="add darks of the flats' exposure, or of several exposures")
        return f"dark ladder interpolated to {exposure_s:g} s"

    def _line_dn(self, exposure_s: float) -> float:
        a, b = self._weights(exposure_s)
        return float(self._n * (a + b * self._t) @ [one.level_dn for one in self.levels])

    def _weights(self, exposure_s: float) -> tuple[float, float]:
        """a, b: the least-squares line at this exposure is the sum over the frames of (a + b t) times the frame's value."""
        n, t = self._n, self._t
        whole, first, second = n.sum(), n @ t, n @ t**2
        if np.ptp(t) == 0:
            return 1 / whole, 0.0
        scale = whole * second - first**2
        return (second - exposure_s * first) / scale, (exposure_s * whole - first) / scale

    def _rate(self) -> np.ndarray:
        """(H, W) slope of the line, DN/s."""
        (a, b), (c, d) = self._weights(1.0), self._weights(0.0)
        return np.float32(a - c) * self._sum + np.float32(b - d) * self._sum_t

    def _variance(self) -> np.ndarray:
        """(H, W) temporal variance of one frame; without repeats an upper limit from the scatter over the image."""
        if self._freedom:
            return self._noise / np.float32(self._freedom)
        return most_variance_dn2(self._kept[0][1])


def _same(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and abs(a - b) <= SAME_EXPOSURE * b


class MapDark:
    """The dark below flats as a map has it.

    Raises:
        BadInput: there is no map with a dark, or it is of another size.
    """

    def __init__(self, calmap: CalibrationMap | None, first: Frame):
        if calmap is None or "offset_dn" not in calmap.measured:
            raise BadInput("flats need darks: none are among the frames, and no map with dark layers was given",
                           mend="add dark frames of the same exposure, or give --map with a measured dark")
        if calmap.image_size_px != first.image_size_px:
            raise BadInput(f"the map is of {calmap.image_size_px} px, the flats of {first.image_size_px} px")
        self._map = calmap
        self.pixels = calmap.offset_dn.size
        self.noise_known = "read_noise_dn" in calmap.measured

    def noise_dn2(self, exposure_s: float | None) -> float:
        """Mean temporal variance of one frame."""
        return float(np.mean(self._map.read_noise_dn.astype(float) ** 2))

    def level_dn(self, exposure_s: float | None) -> float:
        """Mean dark level at an exposure."""
        rated = exposure_s is not None and "dark_rate_dn_per_s" in self._map.measured
        return float(np.mean(self._map.offset_dn) + (exposure_s * np.mean(self._map.dark_rate_dn_per_s) if rated else 0.0))

    def image(self, exposure_s: float | None) -> tuple[np.ndarray, np.ndarray, str]:
        """Dark image (H, W), its variance, and how it was had."""
        dark, variance = self._map.offset_dn, self._map.offset_uncertainty_dn**2
        if exposure_s is None or "dark_rate_dn_per_s" not in self._map.measured:
            return dark, variance, "offset of the map"
        return (dark + exposure_s * self._map.dark_rate_dn_per_s,
                variance + (exposure_s * self._map.dark_rate_uncertainty_dn_per_s) ** 2,
                f"dark layers of the map at {exposure_s:g} s")
