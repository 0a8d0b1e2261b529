"""Does a frame that claims to be dark look dark? Level, light fall-off, and point sources wider than one pixel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import BadInput
from ...records import Frame
from ...spots.background import background_and_noise
from .._defects import background, core_sigma, typical
from .._frames.glance import glance
from .._quantiles import quantiles, row_medians

MAX_LEVEL = 0.5  # of the range: beyond it no dark
HIGH_LEVEL = 0.15  # of the range: darker cameras are the rule, so this is said
MAX_SATURATED = 0.01
EVEN = 0.03  # scatter of the dark rate over the pixels, noise included, below which it is no dark current
MAX_STRUCTURE = 0.05  # of the range between dim and bright blocks; amplifier glow stays below
MAX_STRUCTURE_OF_LEVEL, MAX_STRUCTURE_DN = 0.1, 30.0  # of the level itself, but at least these DN, where the range is not known
MAX_EQUAL = 0.9  # of the pixels at one value: a picture without noise is no picture of the dark
# A hot pixel keeps its light to itself (0.95 of the 3 pixels about it), a star or a pinhole shares it (0.5 to 0.7) both along
# the row and along the column. A hot column shares it along the column alone.
WIDE = 0.8
BRIGHT_SIGMA = 20.0
MOST_WIDE, MOST_WIDE_SHARE = 8, 0.15
SAMPLE_PX = 20_000
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


def high_level(level_dn: float, white_level_dn: float) -> tuple[str, ...]:
    """What has to be said of darks whose brightest exposure has this mean level: an even light on all of them shows in nothing
    else."""
    if level_dn <= HIGH_LEVEL * white_level_dn:
        return ()
    return (f"the darks reach {level_dn:.0f} DN of {white_level_dn:.0f}: a high black level, much dark current, or light "
            "comes in",)


def check_light(signal_dn: float, white_level_dn: float, rate: Callable[[], np.ndarray], bayer_pattern: str | None) -> None:
    """Refuse darks whose signal grows with exposure as evenly over the pixels as light does.

    Dark current differs from pixel to pixel by a tenth and more, the response to light by a hundredth. Only a signal that is
    large is judged: what is small may be even by a sensor's good making, and does little harm.

    Args:
        signal_dn: mean dark signal at the longest exposure. rate: gives the dark rate (H, W).

    Raises:
        BadInput: it is light.
    """
    if signal_dn <= HIGH_LEVEL * white_level_dn:
        return
    image = rate()
    around = background(image, bayer_pattern)
    spread = typical(core_sigma(image - around, bayer_pattern)) / typical(around)
    if spread < EVEN:
        raise BadInput(f"the darks are lit: their level grows with exposure by {signal_dn:.0f} DN of {white_level_dn:.0f}, "
                       f"alike in all pixels to {100 * spread:.1f} %, as light does and dark current does not",
                       mend="cap the lens, close the room; were the folders swapped? If it is dark current all the same, take "
                       "shorter darks or cool the sensor")


def _why_not(frame: Frame) -> str | None:
    if frame.kind in ("flat", "light"):
        return f"this frame says that it is a {frame.kind} frame, not a dark"
    seen, sample = glance(frame), _sample(frame.data)
    white, level = frame.white_level_dn, float(row_medians(sample.ravel()))
    saturated = seen.saturated(white)
    if level > MAX_LEVEL * white:
        return f"no dark frame: its level is {level:.0f} DN of {white:.0f}"
    if saturated > MAX_SATURATED:
        return f"no dark frame: {100 * saturated:.1f} % of the pixels are saturated"
    if frame.range_assumed and level > 0 and np.mean(sample == level) > MAX_EQUAL:
        return f"no dark frame: nearly every pixel is at {level:.0f} DN, which is the end of its range or no picture at all"
    low, high = quantiles(seen.blocks_dn, (0.02, 0.98))
    guess = max(MAX_STRUCTURE_OF_LEVEL * level, MAX_STRUCTURE_DN)
    if high - low > min(MAX_STRUCTURE * white, guess if frame.range_assumed else np.inf):
        return f"no dark frame: its level runs from {low:.0f} to {high:.0f} DN over the image, light comes in"
    middle = _middle(frame.data)
    steps = np.abs(np.diff(sample, axis=1))  # of neighbours in the sample: a gradient does not count
    noise = 1.4826 / np.sqrt(2) * float(row_medians(steps.ravel())) if steps.size else 0.0
    bright = int(seen.blocks_dn.min() + BRIGHT_SIGMA / 2 * noise)
    if seen.largest <= bright or np.count_nonzero(middle > bright) <= MOST_WIDE:
        return None  # too few bright pixels for so many points, wherever the background is lowest
    wide, peaks = wide_peaks(middle)
    if wide > MOST_WIDE and wide > MOST_WIDE_SHARE * peaks:
        return f"no dark frame: {wide} of its {peaks} bright points are wider than a pixel, as stars and pinholes are"
    return None


def _sample(data: np.ndarray) -> np.ndarray:
    """Every so many rows and columns, float32: SAMPLE_PX pixels give the median to 1 % of the noise."""
    step = max(1, int(np.sqrt(data.size / SAMPLE_PX)))
    return data[::step, ::step].astype(np.float32)


def _middle(data: np.ndarray) -> np.ndarray:
    y, x = (max(0, (n - PROBED_PX) // 2) for n in data.shape)
    return data[y:y + PROBED_PX, x:x + PROBED_PX]


def wide_peaks(middle: np.ndarray) -> tuple[int, int]:
    """How many bright local maxima share their light with their neighbours, and how many bright maxima there are."""
    middle = middle.astype(np.float32)
    background, noise = background_and_noise(middle)
    signal = middle - background
    rows, columns = np.nonzero((signal > BRIGHT_SIGMA * noise) & (middle < middle.max()))
    around = np.pad(signal, 1, mode="symmetric")
    patch = np.stack([around[rows + i, columns + j] for i in range(3) for j in range(3)]).reshape(3, 3, -1)
    patch = patch[..., patch[1, 1] == patch.max(axis=(0, 1))]
    lit = np.maximum(patch, 0)
    own = np.maximum(patch[1, 1] / lit[1].sum(axis=0), patch[1, 1] / lit[:, 1].sum(axis=0))
    return int(np.count_nonzero(own < WIDE)), len(own)
