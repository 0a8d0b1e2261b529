"""Curves that show the fixed pattern of a mean image: spectrograms, profiles, histograms (EMVA 1288 R4 Linear, section 8)."""

from __future__ import annotations

import cv2
import numpy as np

BINS = 256  # at most, in a logarithmic histogram


def spectrogram(filtered: np.ndarray) -> np.ndarray:
    """(W // 2 + 1,) root of the mean power over the rows of a high-passed image, in its unit; from 0 to 0.5 cycles a pixel.

    White noise of variance s^2 lies at s. Transpose the image for the columns.
    """
    h, n = filtered.shape
    waves = cv2.dft(np.ascontiguousarray(filtered, np.float32), flags=cv2.DFT_ROWS)  # each row: mean, real, imaginary, ...
    squares = np.einsum("ij,ij->j", waves, waves) / (h * n)
    power = np.zeros(n // 2 + 1)
    power[0] = squares[0]
    power[1:] += squares[1::2]
    power[1:(n + 1) // 2] += squares[2::2]
    return np.sqrt(power)


def profiles(image: np.ndarray) -> np.ndarray:
    """(4, W): the middle row, and mean, minimum and maximum over the rows; not high-passed."""
    return np.stack([image[image.shape[0] // 2], image.mean(axis=0), image.min(axis=0), image.max(axis=0)])


def histogram(filtered: np.ndarray, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Counts (B,) and edges (B + 1,) in the image's unit of the deviations of all pixels, for a logarithmic plot.

    Bins are whole steps of the sum of the stack's frames, so that none is favoured: I = floor(range / 256) + 1 steps.
    """
    steps = np.rint(filtered * frames).astype(np.int32)
    low, high = int(steps.min()), int(steps.max())
    width = (high - low) // BINS + 1
    counts = np.bincount(((steps - low) // width).ravel(), minlength=(high - low) // width + 1)
    return counts, (low + width * np.arange(len(counts) + 1) - 0.5) / frames


def accumulated(filtered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Absolute deviation (B,) from the mean in the image's unit, and the percentage (B,) of pixels that deviate by as much."""
    deviation = filtered - filtered.mean()
    np.abs(deviation, out=deviation)
    counts, edges = np.histogram(deviation, bins=BINS)
    return edges[:-1], 100 * counts[::-1].cumsum()[::-1] / filtered.size
