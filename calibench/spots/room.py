"""Room: the arrays in which the compiled scan works, made once for frames of one size."""

from __future__ import annotations

import numpy as np

LARGEST_FRACTION, LARGEST_AT_LEAST = 2e-3, 1000  # of the frame's area, pixels; beyond: a roof, a moon, a cloud
MOST_PEAKS = 20_000  # the first of the frame; it is full of something else than stars


class Room:
    """Arrays for frames (H, W), as `spots/detect/kernels.py` wants them.

    labels: all below `lowest`, which rises with each frame, so that they are cleared only when the numbers run out."""

    def __init__(self, shape: tuple[int, int]) -> None:
        h, w = shape
        self.shape = shape
        self.labels, self.lowest = np.zeros(shape, np.int32), 1
        self.above = np.zeros((w + 63) // 64 * 64, bool)
        self.eight = self.above.view(np.uint64)
        self.waiting = np.empty((2, w + 8), np.int64)
        self.peaks = np.empty((MOST_PEAKS, 3))
        self.stack = np.empty(max(int(LARGEST_FRACTION * h * w), LARGEST_AT_LEAST) + 16, np.int64)

    def clear(self) -> int:
        """The lowest label that is free for a frame; that frame may give MOST_PEAKS."""
        if self.lowest > np.iinfo(np.int32).max - 2 * MOST_PEAKS:
            self.labels[:], self.lowest = 0, 1
        self.lowest += MOST_PEAKS
        return self.lowest - MOST_PEAKS
