"""One streaming pass over frames taken alike: exact integer sums, and the temporal noise free of a common drift.

Beside sum and sum of squares, a third sum weights each frame by its own level (mean over the frame). It gives each
pixel's regression on the common level, so that a warming sensor or a flickering lamp does not count as noise
of the pixels. Frames wait until a batch is full, because loading and storing the sums costs more than adding one frame to
them; before the first batch there are no sums, so that a stack never holds more than a batch of frames beyond them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from ...records import Frame, FrameStack
from ..kernels import add_frames, steady_squares
from .glance import glance

MIN_FRAMES_FOR_SLOPE = 4
BATCH = 8
NARROW, WIDE = (np.int32, np.uint32, np.int32), (np.int32, np.int64, np.int64)  # sums, squares, weighted: 12 or 20 bytes
WEIGHTS_PER_DN = 256  # levels are weights in this integer step: its rounding adds 1e-6 DN^2 to the steady variance


@dataclass(frozen=True, kw_only=True)
class Series:
    """A stack with what only the order of its frames shows.

    levels_dn: (N,) mean of each frame. steady_variance_dn2: (H, W) float32, temporal variance with the common level's part
    removed, over `freedom` degrees of freedom (NaN where that is 0).
    """

    stack: FrameStack
    levels_dn: np.ndarray
    steady_variance_dn2: np.ndarray
    freedom: int

    @property
    def mean_dn(self) -> np.ndarray:
        """(H, W) float32, made anew at each call."""
        return mean_image(self.stack.sum_dn, self.stack.count)


class Accumulator:
    """Takes frames of one kind one by one; `series` is valid after each."""

    def __init__(self) -> None:
        self._levels: list[float] = []
        self._weights: list[int] = []  # level of each frame above `reference`, in steps of 1 / WEIGHTS_PER_DN
        self._reference_dn = 0
        self._waiting: list[np.ndarray] = []
        self._sums: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._lent = False  # a series holds the sums: they are copied before the next frame is added
        self._shape: tuple[int, int] | None = None
        self._widest = 0  # largest |pixel|
        self._narrow = True  # squares and weighted sums still fit into 32 bits

    def add(self, frame: Frame) -> None:
        """Add a frame.

        Raises:
            BadInput: its size differs, its values are no integers (sums would not be exact), or there are more frames than
                exact sums can hold (32,000 of the full 16 bits; of narrower values more).
        """
        seen = glance(frame)
        values, pixels = seen.values, seen.values.size
        if self._shape is None:
            self._shape, self._reference_dn = values.shape, round(seen.level_dn)
        if values.shape != self._shape:
            raise BadInput(f"image size is {frame.image_size_px} px, but {self._shape[::-1]} px before",
                           file=frame.file or None)
        self._require_room(self.count + 1, max(self._widest, seen.largest, -seen.smallest), frame.file or None)
        if self._waiting and self._waiting[0].dtype != values.dtype:
            self.settle()
        self._weights.append((WEIGHTS_PER_DN * (seen.total_dn - self._reference_dn * pixels) + pixels // 2) // pixels)
        self._levels.append(seen.level_dn)
        self._waiting.append(values.reshape(-1))
        if len(self._waiting) == BATCH:
            self.settle()

    def merge(self, other: Accumulator) -> None:
        """Take in the frames of another accumulator, as if they had been added here after its own: exact in any order.

        Raises:
            BadInput: its size differs, or there are more frames than exact sums can hold.
        """
        if not other.count:
            return
        if self._shape is None:
            self._shape, self._reference_dn = other._shape, other._reference_dn
        if other._shape != self._shape:
            raise BadInput(f"a stack of {other._shape[::-1]} px does not go with one of {self._shape[::-1]} px")
        self._require_room(self.count + other.count, max(self._widest, other._widest), None)
        self.settle()
        other.settle()
        self._widen()
        self._own_sums()
        further = WEIGHTS_PER_DN * (other._reference_dn - self._reference_dn)
        for mine, theirs in zip(self._sums, other._sums, strict=True):
            mine += theirs
        self._sums[2][:] += further * other._sums[0].astype(np.int64)
        self._weights += [weight + further for weight in other._weights]
        self._levels += other._levels

    @property
    def waiting(self) -> int:
        """Frames held until a batch is full."""
        return len(self._waiting)

    def settle(self) -> None:
        """Add the waiting frames to the sums now."""
        if self._sums is None:
            pixels = self._shape[0] * self._shape[1]
            self._sums = tuple(np.zeros(pixels, dtype) for dtype in (NARROW if self._narrow else WIDE))
        count = len(self._waiting)
        if count:
            if self.count * self._widest**2 >= 2**32 or sum(map(abs, self._weights)) * self._widest >= 2**31:
                self._widen()
            self._own_sums()
            weights = np.array(self._weights[-count:], np.int32)
            add_frames(tuple(self._waiting) + (self._waiting[0],) * (BATCH - count), count, weights, *self._sums)
            self._waiting.clear()

    @property
    def count(self) -> int:
        """Frames taken so far."""
        return len(self._levels)

    @property
    def level_dn(self) -> float:
        """Mean level of the frames so far."""
        return float(np.mean(self._levels))

    def series(self) -> Series:
        """Mean, variance, and the variance about the common level.

        Raises:
            BadInput: no frame was added.
        """
        n = self.count
        if n == 0:
            raise BadInput("a stack of no frames")
        self.settle()
        total, squares, weighted = self._sums
        weights = np.array(self._weights) / WEIGHTS_PER_DN
        spread = float(np.sum((weights - weights.mean()) ** 2))
        # With too few frames for a slope of its own every pixel follows the level (the pair formula of EMVA 1288).
        own_slope = n >= MIN_FRAMES_FOR_SLOPE and spread > 0
        freedom = n - 2 if own_slope else n - 1
        steady = np.empty(total.size, np.float32)
        steady_squares(total, squares, weighted, n, float(sum(self._weights)), 1 / WEIGHTS_PER_DN, spread, own_slope, steady)
        if freedom:
            steady /= np.float32(freedom)
        else:
            steady[:] = np.nan
        self._lent = True
        stack = FrameStack(sum_dn=total.reshape(self._shape), sum_sq_dn2=squares.reshape(self._shape), count=n)
        return Series(stack=stack, levels_dn=np.array(self._levels), freedom=freedom,
                      steady_variance_dn2=steady.reshape(self._shape))

    def _own_sums(self) -> None:
        if self._lent:
            self._sums, self._lent = tuple(part.copy() for part in self._sums), False

    def _widen(self) -> None:
        if self._narrow:
            self._narrow = False
            self._sums = tuple(part.astype(dtype, copy=False) for part, dtype in zip(self._sums, WIDE, strict=True))

    def _require_room(self, n: int, x: int, file: str | None) -> None:
        """Every integer stays below its type's end: weight and sum(x) in int32, n sum(x^2) and sum(weight x) in int64."""
        weight = 2 * x * WEIGHTS_PER_DN  # level and reference may have either sign
        if max(n * x, weight) >= 2**31 or (n * x) ** 2 >= 2**63 or n * x * weight >= 2**63:
            raise BadInput(f"more than {n - 1} frames of values this wide do not fit into exact sums", file=file,
                           mend="give fewer frames")
        self._widest = x


def mean_image(sum_dn: np.ndarray, count: int) -> np.ndarray:
    """(H, W) float32 mean of `count` frames from their sum; equal sums give equal means."""
    out = np.empty(sum_dn.shape, np.float32)  # by parts in float64
    return np.divide(sum_dn, count, out=out, dtype=np.float64, casting="unsafe")


def accumulate(frames: Iterable[Frame]) -> FrameStack:
    """One pass over frames taken alike.

    Raises:
        BadInput: no frame, mixed sizes, or values that are no integers.
    """
    accumulator = Accumulator()
    for frame in frames:
        accumulator.add(frame)
    return accumulator.series().stack
