"""A glance at one frame as it streams by: its whole values, and the few figures that every check on the way needs.

One pass adds up bands of rows; level, block means and what tells a copy follow from these sums, which are exact.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...errors import BadInput
from ...records import Frame
from ..kernels import band_sums

BLOCK_PX = 32
WIDEST_BITS = 21  # of one frame's values, for sums of many to stay exact


@dataclass(frozen=True, kw_only=True)
class Glance:
    """values: (H, W) uint16, or int32 where they do not fit, read-only. smallest, largest: in DN, over the frame (smallest is
    0 where no value can be negative); at_largest: how many pixels have the largest. bands: (B, W) integer sums over bands of
    BLOCK_PX rows, the last with those left over.
    """

    values: np.ndarray
    smallest: int
    largest: int
    at_largest: int
    bands: np.ndarray

    @cached_property
    def total_dn(self) -> int:
        """Sum of all pixels."""
        return int(self.bands.sum(dtype=np.int64))

    @property
    def level_dn(self) -> float:
        """Mean over the frame."""
        return self.total_dn / self.values.size

    @cached_property
    def blocks_dn(self) -> np.ndarray:
        """(B, C) means of blocks of BLOCK_PX x BLOCK_PX; those of the last row and column are larger."""
        (h, w), (bands, columns) = self.values.shape, (len(self.bands), max(1, self.values.shape[1] // BLOCK_PX))
        rows = np.full(bands, BLOCK_PX) if bands > 1 else np.array([h])
        rows[-1] = h - BLOCK_PX * (bands - 1)
        wide = np.full(columns, BLOCK_PX)
        wide[-1] = w - BLOCK_PX * (columns - 1)
        return np.add.reduceat(self.bands, BLOCK_PX * np.arange(columns), axis=1, dtype=np.int64) / np.outer(rows, wide)

    def saturated(self, white_level_dn: float) -> float:
        """Share of the pixels at or above the white level."""
        if self.largest <= white_level_dn:
            return self.at_largest / self.values.size if self.largest == white_level_dn else 0.0
        return float(np.count_nonzero(self.values >= white_level_dn)) / self.values.size

    @cached_property
    def noisy(self) -> bool:
        """Whether most sums differ from their neighbours': frames without noise may be alike by chance."""
        return bool(np.count_nonzero(np.diff(self.bands.astype(np.int64), axis=1)) * 2 > self.bands.size)

    @cached_property
    def digest(self) -> int:
        """The same for the same pixels; two frames with noise of their own never share it."""
        return hash((self.values.shape, self.blocks_dn.tobytes()))


_last: tuple[Callable[[], Frame | None], Glance | None] = (lambda: None, None)


def glance(frame: Frame) -> Glance:
    """The glance at a frame. The last one is kept, because check, ledger and stack ask for it one after the other.

    Raises:
        BadInput: its values are no whole numbers, so that sums would not be exact.
    """
    global _last
    if _last[0]() is not frame:
        _last = weakref.ref(frame, _forget), _look(frame)
    return _last[1]


def _forget(gone: weakref.ref) -> None:
    """The pixels need not outlive their frame."""
    global _last
    if _last[0] is gone:
        _last = (lambda: None), None


def _look(frame: Frame) -> Glance:
    values = _whole(frame)
    bands = np.zeros((max(1, values.shape[0] // BLOCK_PX), values.shape[1]),
                     np.uint32 if values.dtype == np.uint16 else np.int64)
    largest, at_largest = band_sums(values, BLOCK_PX, bands)
    return Glance(values=values, bands=bands, largest=int(largest), at_largest=int(at_largest),
                  smallest=0 if values.dtype == np.uint16 else int(values.min()))


def _whole(frame: Frame) -> np.ndarray:
    """The pixels as the kernels take them: contiguous, aligned, read-only."""
    data = frame.data
    if data.dtype.kind not in "ui" and not np.array_equal(data, np.rint(data)):
        raise BadInput(f"pixel values are no whole DN ({data.dtype})", file=frame.file or None,
                       mend="give frames as the camera made them, not averaged or scaled copies")
    if data.dtype not in (np.uint8, np.uint16):
        low, high = data.min(), data.max()
        if max(-low, high) >= 2**WIDEST_BITS:
            raise BadInput(f"values from {low:g} to {high:g} are wider than {WIDEST_BITS} bits", file=frame.file or None,
                           mend="give single raw frames, not sums of many")
        data = data.astype(np.uint16 if low >= 0 and high < 2**16 else np.int32)
    values = np.require(data, np.uint16 if data.dtype == np.uint8 else data.dtype, ("C", "A")).view()
    values.flags.writeable = False
    return values
