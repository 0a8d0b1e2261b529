"""Saddle points of the light: what the inner corners of a checkerboard look like, whatever else stands in the image.

1. Second derivatives of the smoothed light; a saddle is where they have opposite signs, strongest among its neighbours.
2. Around a corner the light alternates four times and is the same after half a turn; an edge that meets another does not.
3. The edges through a corner run where the second derivative vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

SMOOTH_PX = 1.2
APART_PX = 4
WEAKEST = 0.02  # of the strongest corners' second derivatives
STRONGEST = 50  # that many tell what a strong one is
MOST = 1500  # more are no board but noise
RING_PX = 4.0
RING = 16
LEAST_LIKENESS = 0.6  # correlation of the ring with itself after half a turn


@dataclass(frozen=True, kw_only=True)
class Saddles:
    """N saddle points: xy_px (N, 2) to about half a pixel; edges (N, 2, 2) unit vectors along the two edges, so ordered that
    the light is bright between the first and the second when turning from x (right) to y (down)."""

    xy_px: np.ndarray
    edges: np.ndarray


def saddles(grey: np.ndarray) -> Saddles:
    """The saddle points of an image (H, W) that may be corners of a checkerboard."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTH_PX)
    xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / 4) for order in ((2, 0), (0, 2), (1, 1)))
    strength = xy * xy - xx * yy
    side = 2 * APART_PX + 1
    peak = (strength >= cv2.dilate(strength, np.ones((side, side), np.uint8))) & (strength > 0)
    row, column = np.nonzero(peak)
    size = strength[row, column]
    order = np.argsort(-size)[:MOST]
    strong = size[order[:STRONGEST]]
    order = order[size[order] > WEAKEST * (np.median(strong) if len(strong) else 0.0)]
    row, column = row[order], column[order]
    at = np.column_stack([column, row]).astype(float)
    alike = _alternates(smooth, at)
    return Saddles(xy_px=at[alike], edges=_edges(*(d[row[alike], column[alike]].astype(float) for d in (xx, xy, yy))))


def sampled(image: np.ndarray, xy_px: np.ndarray) -> np.ndarray:
    """Light (...) of a float32 image at places (..., 2) px, bilinear; NaN outside."""
    x, y = np.moveaxis(xy_px.astype(np.float32), -1, 0)
    rows = (-1, x.shape[-1])  # OpenCV takes no row of 32768 and more
    flat = cv2.remap(image, x.reshape(rows), y.reshape(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (x < 0) | (y < 0) | (x > image.shape[1] - 1) | (y > image.shape[0] - 1)
    return np.where(outside, np.nan, flat.reshape(x.shape))


def likeness(ring: np.ndarray) -> np.ndarray:
    """Correlation (N,) of the light on rings (N, R) with itself after half a turn; -1 where a ring leaves the image."""
    d = ring - ring.mean(axis=1, keepdims=True)
    turned = np.roll(d, ring.shape[1] // 2, axis=1)
    return np.nan_to_num((d * turned).sum(axis=1) / np.maximum((d * d).sum(axis=1), 1e-9), nan=-1.0)


def circle(count: int = RING) -> np.ndarray:
    """(count, 2) places on the unit circle."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _alternates(smooth: np.ndarray, at: np.ndarray) -> np.ndarray:
    if not len(at):
        return np.zeros(0, bool)
    ring = sampled(smooth, at[:, None] + RING_PX * circle())
    bright = ring > (ring.max(axis=1, keepdims=True) + ring.min(axis=1, keepdims=True)) / 2
    changes = (bright != np.roll(bright, 1, axis=1)).sum(axis=1)
    return (changes == 4) & (likeness(ring) > LEAST_LIKENESS)


def _edges(xx: np.ndarray, xy: np.ndarray, yy: np.ndarray) -> np.ndarray:
    """Where xx c^2 + 2 xy c s + yy s^2 = 0, c and s the cosine and sine of an edge's angle."""
    half_trace, difference = (xx + yy) / 2, (xx - yy) / 2
    size = np.hypot(difference, xy)  # second derivative at angle t: half_trace + size cos(2 t - axis)
    axis = np.arctan2(xy, difference)
    opening = np.arccos(np.clip(-half_trace / np.maximum(size, 1e-12), -1, 1))
    # the derivative is positive (dark) within opening / 2 of axis / 2: bright lies between the end of that and its other start
    first, second = (axis + opening) / 2, (axis - opening) / 2 + np.pi
    return np.stack([np.stack([np.cos(t), np.sin(t)], -1) for t in (first, second)], axis=1)
