"""Does a frame that claims to be dark look dark? Level, light fall-off, and point sources wider than one pixel."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from ..errors import BadInput
from ..records import Frame
from ..spots.background import background_and_noise
from ._defects import BLOCK_PX

MAX_LEVEL = 0.5  # of the range: beyond it no dark
MAX_SATURATED = 0.01
MAX_STRUCTURE = 0.05  # of the range between dim and bright blocks; amplifier glow stays below
MAX_STRUCTURE_OF_LEVEL, MAX_STRUCTURE_DN = 0.1, 30.0  # of the level itself, but at least these DN, where the range is not known
MAX_EQUAL = 0.9  # of the pixels at one value: a picture without noise is no picture of the dark
# A hot pixel keeps its light to itself (0.9 of its 3x3), a star or a pinhole shares it (0.3 to 0.5).
WIDE = 0.65
BRIGHT_SIGMA = 20.0
MOST_WIDE, MOST_WIDE_SHARE = 8, 0.15
PROBED_PX = 1024  # the middle of a large frame is enough
MEND = "cap the lens, close the room; were the folders swapped? If it is dark all the same, state bit_depth in a sidecar"


def check_dark(frame: Frame) -> None:
    """Refuse what is not dark.

    Raises:
        BadInput: the frame says that it is something else, is bright, saturated, without noise, or shows a scene, light
            fall-off or point sources.
    """
    reason = _why_not(frame)
    if reason:
        raise BadInput(reason, file=frame.file or None, mend=MEND)


def _why_not(frame: Frame) -> str | None:
    if frame.kind in ("flat", "light"):
        return f"this frame says that it is a {frame.kind} frame, not a dark"
    white, level = frame.white_level_dn, float(np.median(frame.data))
    saturated = float(np.mean(frame.data >= white))
    if level > MAX_LEVEL * white:
        return f"no dark frame: its level is {level:.0f} DN of {white:.0f}"
    if saturated > MAX_SATURATED:
        return f"no dark frame: {100 * saturated:.1f} % of the pixels are saturated"
    if frame.range_assumed and level > 0 and np.mean(frame.data == level) > MAX_EQUAL:
        return f"no dark frame: nearly every pixel is at {level:.0f} DN, which is the end of its range or no picture at all"
    w, h = (max(1, round(n / BLOCK_PX)) for n in frame.image_size_px)
    blocks = cv2.resize(frame.data.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA)
    low, high = np.percentile(blocks, (2, 98))
    guess = max(MAX_STRUCTURE_OF_LEVEL * level, MAX_STRUCTURE_DN)
    if high - low > min(MAX_STRUCTURE * white, guess if frame.range_assumed else np.inf):
        return f"no dark frame: its level runs from {low:.0f} to {high:.0f} DN over the image, light comes in"
    wide, peaks = wide_peaks(frame.data)
    if wide > MOST_WIDE and wide > MOST_WIDE_SHARE * peaks:
        return f"no dark frame: {wide} of its {peaks} bright points are wider than a pixel, as stars and pinholes are"
    return None


def wide_peaks(data: np.ndarray) -> tuple[int, int]:
    """How many bright local maxima share their light with their neighbours, and how many bright maxima there are."""
    y, x = (max(0, (n - PROBED_PX) // 2) for n in data.shape)
    middle = data[y:y + PROBED_PX, x:x + PROBED_PX].astype(np.float32)
    background, noise = background_and_noise(middle)
    signal = middle - background
    peak = (signal == ndimage.maximum_filter(signal, 3)) & (signal > BRIGHT_SIGMA * noise) & (middle < middle.max())
    around = 9 * ndimage.uniform_filter(np.maximum(signal, 0), 3)
    own = signal[peak] / around[peak]
    return int(np.count_nonzero(own < WIDE)), len(own)
