"""One streaming pass over frames taken alike: exact integer sums, and the temporal noise free of a common drift.

Beside sum and sum of squares, a third sum weights each frame by its own level (mean over the frame). It gives each
pixel's regression on the common level, so that a warming sensor or a flickering lamp does not count as noise
of the pixels. Memory does not grow with the number of frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import Frame, FrameStack

MIN_FRAMES_FOR_SLOPE = 4


@dataclass(frozen=True, kw_only=True)
class Series:
    """A stack with what only the order of its frames shows.

    levels_dn: (N,) mean of each frame. steady_variance_dn2: (H, W) temporal variance with the common level's part removed,
    over `freedom` degrees of freedom (NaN where that is 0). slope: (H, W) change of the pixel for a change of 1 in the level.
    """

    stack: FrameStack
    levels_dn: np.ndarray
    steady_variance_dn2: np.ndarray
    freedom: int
    slope: np.ndarray


class Accumulator:
    """Takes frames of one kind one by one; `series` is valid after each."""

    def __init__(self) -> None:
        self._levels: list[float] = []
        self._sum = self._sum_sq = self._weighted = None
        self._shift = 0

    def add(self, frame: Frame) -> None:
        """Add a frame.

        Raises:
            BadInput: its size differs, or its values are no integers (sums would not be exact).
        """
        data = frame.data
        if data.dtype.kind not in "ui":
            if not np.array_equal(data, np.rint(data)):
                raise BadInput(f"pixel values are no whole DN ({data.dtype})", file=frame.file or None,
                               mend="give frames as the camera made them, not averaged or scaled copies")
            data = data.astype(np.int64)
        if self._sum is None:
            self._shift = int(np.median(data))
            self._sum, self._sum_sq = np.zeros(data.shape, np.int64), np.zeros(data.shape, np.int64)
            self._weighted = np.zeros(data.shape)
        if data.shape != self._sum.shape:
            raise BadInput(f"image size is {frame.image_size_px} px, but {self._sum.shape[::-1]} px before",
                           file=frame.file or None)
        shifted = data.astype(np.int64) - self._shift
        level = float(shifted.mean())
        self._sum += shifted
        self._sum_sq += shifted * shifted
        self._weighted += level * shifted
        self._levels.append(level)

    @property
    def count(self) -> int:
        """Frames taken so far."""
        return len(self._levels)

    @property
    def level_dn(self) -> float:
        """Mean level of the frames so far."""
        return float(np.mean(self._levels)) + self._shift

    def series(self) -> Series:
        """Mean, variance, and the variance about the common level.

        Raises:
            BadInput: no frame was added.
        """
        n = self.count
        if n == 0:
            raise BadInput("a stack of no frames")
        mean = self._sum / n
        squares = self._sum_sq - self._sum * mean  # sum of squared deviations
        nothing = np.full(mean.shape, np.nan)
        levels = np.array(self._levels)
        spread = float(np.sum((levels - levels.mean()) ** 2))
        cross = self._weighted - levels.mean() * self._sum
        if n >= MIN_FRAMES_FOR_SLOPE and spread > 0:
            slope, freedom = cross / spread, n - 2
            steady = np.maximum(squares - cross * slope, 0)
        else:  # too few frames for a slope of its own: every pixel follows the level (the pair formula of EMVA 1288)
            slope, freedom = np.ones(mean.shape), n - 1
            steady = np.maximum(squares - 2 * cross + spread, 0)
        stack = FrameStack(mean_dn=mean + self._shift, variance_dn2=squares / (n - 1) if n > 1 else nothing, sum_dn=self._sum,
                           sum_sq_dn2=self._sum_sq, shift_dn=self._shift, count=n)
        return Series(stack=stack, levels_dn=levels + self._shift, freedom=freedom, slope=slope,
                      steady_variance_dn2=steady / freedom if freedom else nothing)


def accumulate(frames: Iterable[Frame]) -> FrameStack:
    """One pass over frames taken alike.

    Raises:
        BadInput: no frame, mixed sizes, or values that are no integers.
    """
    accumulator = Accumulator()
    for frame in frames:
        accumulator.add(frame)
    return accumulator.series().stack
