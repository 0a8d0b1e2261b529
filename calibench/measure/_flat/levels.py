"""Flats sorted as they stream by: figures of every level of light, images only of those that the response may come from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...records import Frame
from .._dark.below import DarkBelow
from .._dark.levels import DarkLevels, dark_level
from .._defects import typical
from .._frames.open_stacks import OpenStacks
from .._frames.stack import Accumulator

SAME_LEVEL = 0.05  # frames of one exposure whose means differ by less belong to one light level
RIGHT_FILL, NEAR_HALF = 0.5, 0.2
OPEN_BYTES = 125_000_000


@dataclass(frozen=True, kw_only=True)
class FlatLevel:
    """Flats of one exposure and one light: mean of each frame, median of their mean image, share of its pixels that are
    saturated, mean temporal variance (None: a single flat). The mean image and its temporal variance, (H, W) float32, are None
    where the response is better taken from another level."""

    exposure_s: float | None
    files: tuple[str, ...]
    levels_dn: np.ndarray
    typical_dn: float
    saturated: float
    variance_dn2: float | None
    freedom: int
    mean_image_dn: np.ndarray | None
    variance_image_dn2: np.ndarray | None

    @property
    def count(self) -> int:
        return len(self.levels_dn)

    @property
    def level_dn(self) -> float:
        return float(self.levels_dn.mean())


class FlatLevels:
    """Takes flats and darks one by one; `levels` and `darks` are complete after `close`.

    Args:
        saturated: share of saturated pixels from which a level is of no use.
    """

    def __init__(self, saturated: float):
        self._most_saturated = saturated
        self._open = OpenStacks(OPEN_BYTES)
        self._temperature = DarkLevels()
        self._marks: dict[tuple, list[str]] = {}
        self._white_dn = np.inf
        self._darks: dict[tuple[bool, int], DarkBelow] = {}  # by known exposure and temperature
        self.levels: list[FlatLevel] = []

    def add(self, frame: Frame, level_dn: float) -> None:
        """Add a frame, whose mean is level_dn.

        Raises:
            BadInput: as `Accumulator.add`.
        """
        self._white_dn = frame.white_level_dn
        key = ("dark", *self._temperature.key(frame)) if frame.kind == "dark" else self._flat_key(frame, level_dn)
        if frame.kind != "dark":
            self._marks.setdefault(key, []).append(frame.file or frame.name)
        given_up = self._open.add(key, frame)
        if given_up is not None:
            self._close(*given_up)

    def close(self) -> DarkBelow | None:
        """No more frames. Gives the darks of the temperature with most exposures; None: there were none."""
        for key, stack in self._open.empty():
            self._close(key, stack)
        self.levels.sort(key=lambda level: (level.exposure_s or 0.0, level.level_dn))
        darks, self._darks = self._darks, {}  # whoever is done with them need not keep them here
        known = [below for (stated, _), below in darks.items() if stated] or list(darks.values())
        return max(known, key=lambda below: len(below.levels), default=None)

    def preference(self, level: FlatLevel) -> tuple[bool, int, float]:
        """Smallest for the level to read the response from: no single frame, whose noise is unknown; most frames around
        half of the range, else nearest to half."""
        off = abs(level.typical_dn / self._white_dn - RIGHT_FILL)
        return level.count < 2, -level.count if off < NEAR_HALF else 0, off

    def _flat_key(self, frame: Frame, level_dn: float) -> tuple:
        for key in self._marks:
            if key[1] == frame.exposure_s and key in self._open and (
                    abs(self._open[key].level_dn - level_dn) <= SAME_LEVEL * level_dn):
                return key
        return "flat", frame.exposure_s, len(self._marks)

    def _close(self, key: tuple, stack: Accumulator) -> None:
        if key[0] == "dark":
            self._darks.setdefault((key[1] is not None, key[2]), DarkBelow()).take(dark_level(key[1:], stack))
            return
        series = stack.series()
        mean = series.mean_dn
        saturated = float(np.count_nonzero(mean >= self._white_dn * (1 - 1e-3)) / mean.size)
        self.levels.append(FlatLevel(
            exposure_s=key[1], files=tuple(self._marks[key]), levels_dn=series.levels_dn, typical_dn=typical(mean),
            saturated=saturated, freedom=series.freedom, mean_image_dn=mean,
            variance_image_dn2=series.steady_variance_dn2 if series.freedom else None,
            variance_dn2=float(np.mean(series.steady_variance_dn2, dtype=np.float64)) if series.freedom else None))
        self._keep_images_of_few()

    def _keep_images_of_few(self) -> None:
        """Of the best level, and of the brightest: where that is too dim, for a dark that is not known yet, all are."""
        sound = [v for v in self.levels if v.saturated <= self._most_saturated and v.mean_image_dn is not None]
        kept = [min(sound, key=self.preference), max(sound, key=lambda v: v.typical_dn)] if sound else []
        self.levels = [v if any(v is one for one in kept) else dataclasses.replace(
            v, mean_image_dn=None, variance_image_dn2=None) for v in self.levels]
