"""Darks sorted as they stream by: one stack for each exposure at each temperature, kept small once it is complete.

Frames of one set temperature scatter and drift a little; a step of more than GROUP_C is another temperature. A sensor that
warms slowly stays in its group: a warning tells of the drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...records import Frame
from .._frames.open_stacks import OPEN_BYTES, OpenStacks
from .._frames.stack import Accumulator, Series

GROUP_C = 1.5


@dataclass(frozen=True, kw_only=True)
class DarkLevel:
    """All darks of one exposure (None: unknown) at one temperature.

    group: number of its temperature. celsius: temperature of each frame that states one. mean_dn, variance_dn2: (H, W)
    float32; the temporal variance of one frame with the common drift taken out, over `freedom` degrees of freedom (None where
    that is 0). constant: which pixels have the same value in every frame, as bits (`np.packbits` of (H, W) bool). levels_dn:
    (N,) mean of each frame.
    """

    exposure_s: float | None
    group: int
    celsius: tuple[float, ...]
    mean_dn: np.ndarray
    variance_dn2: np.ndarray | None
    freedom: int
    constant: np.ndarray
    levels_dn: np.ndarray

    @property
    def count(self) -> int:
        return len(self.levels_dn)

    @property
    def temperature_c(self) -> float | None:
        return float(np.mean(self.celsius)) if self.celsius else None


class DarkLevels:
    """Takes darks one by one. Key of a level: (exposure, number of its temperature group)."""

    def __init__(self, most_bytes: int = OPEN_BYTES) -> None:
        self._open = OpenStacks(most_bytes)
        self._closed: dict[tuple, DarkLevel] = {}
        self._celsius: dict[tuple, list[float]] = {}
        self._spans_c: list[tuple[float, float]] = []  # lowest and highest of each temperature group
        self._group = 0

    def key(self, frame: Frame) -> tuple[float | None, int]:
        """Where a frame belongs. A frame without a temperature is taken to be as warm as the one before it."""
        if frame.temperature_c is not None:
            c = frame.temperature_c
            apart = [max(low - c, c - high, 0.0) for low, high in self._spans_c]
            if not apart or min(apart) > GROUP_C:
                self._spans_c.append((c, c))
                apart.append(0.0)
            self._group = int(np.argmin(apart))
            low, high = self._spans_c[self._group]
            self._spans_c[self._group] = min(low, c), max(high, c)
        return frame.exposure_s, self._group

    def add(self, frame: Frame) -> None:
        """Add a frame to its level.

        Raises:
            BadInput: as `Accumulator.add`.
        """
        key = self.key(frame)
        given_up = self._open.add(key, frame)
        if given_up is not None:
            self._close(*given_up)
        if frame.temperature_c is not None:
            self._celsius.setdefault(key, []).append(frame.temperature_c)

    def groups(self) -> tuple[list[list[DarkLevel]], bool]:
        """The levels of each temperature in ascending exposure, in the order in which the temperatures came, and whether frames
        of unknown exposure were dropped because others have one. Call once."""
        for closed in self._open.empty():
            self._close(*closed)
        unknown = {key for key in self._closed if key[0] is None}
        dropped = 0 < len(unknown) < len(self._closed)
        keys = sorted(self._closed.keys() - (unknown if dropped else set()), key=lambda key: (key[1], key[0] or 0.0))
        groups = dict.fromkeys(key[1] for key in keys)
        return [[self._closed[key] for key in keys if key[1] == group] for group in groups], dropped

    def _close(self, key: tuple, stack: Accumulator) -> None:
        level = dark_level(key, stack, self._celsius.get(key, ()))
        self._closed[key] = _merged(self._closed[key], level) if key in self._closed else level


def dark_level(key: tuple[float | None, int], stack: Accumulator, celsius: Sequence[float] = ()) -> DarkLevel:
    """The level of a complete stack."""
    series = stack.series()
    return DarkLevel(
        exposure_s=key[0], group=key[1], celsius=tuple(celsius), mean_dn=series.mean_dn, freedom=series.freedom,
        variance_dn2=series.steady_variance_dn2 if series.freedom else None, constant=_constant(series),
        levels_dn=series.levels_dn)


def _constant(series: Series) -> np.ndarray:
    """As bits: the same value in every frame. The sums tell it; they are looked at only where the noise is small."""
    stack, out = series.stack, np.ones(series.steady_variance_dn2.shape, bool)
    if series.freedom:
        drift = float(np.var(series.levels_dn)) * stack.count / series.freedom
        few = np.nonzero(series.steady_variance_dn2 <= 1.01 * drift + 1e-3)
        out[:] = False
        out[few] = stack.sum_sq_dn2[few].astype(np.int64) * stack.count == stack.sum_dn[few].astype(np.int64) ** 2
    return np.packbits(out)


def _merged(a: DarkLevel, b: DarkLevel) -> DarkLevel:
    """Two stacks of one level as one (Chan, Golub and LeVeque 1983), each frame's own level taken out of the difference."""
    n, m = a.count, b.count
    step = b.mean_dn - a.mean_dn
    own = step - np.float32(b.levels_dn.mean() - a.levels_dn.mean())
    squares = np.float32(n * m / (n + m)) * own**2
    for part in (a, b):
        if part.variance_dn2 is not None:
            squares += np.float32(part.freedom) * part.variance_dn2
    freedom = a.freedom + b.freedom + 1
    return replace(b, mean_dn=a.mean_dn + np.float32(m / (n + m)) * step, variance_dn2=squares / np.float32(freedom),
                   freedom=freedom, constant=a.constant & b.constant & np.packbits(step == 0),
                   levels_dn=np.concatenate([a.levels_dn, b.levels_dn]))
