"""Dust on the window above the sensor: compact shadows in the response, wider than a pixel.

1. The response, its defective pixels filled by 1, is averaged over boxes of SIDE_PX: pixels average out, shadows stay.
2. Connected places that lie more than SIGMA robust sigma and LEAST_DEPTH below the level around are shadows, where they are at
   least as wide as the box and no wider than a share of the image (that would be the lamp).
A shadow stays in the response: it is divided out as long as the dust stays where it is. Dust moves; so it is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from .._defects import core_sigma, typical

SIDE_PX = 5
SIGMA, LEAST_DEPTH = 4.0, 0.003
LEAST_FILL = 0.4  # area of a shadow over that of its bounding box: a scratch or a border has less
WIDEST = 0.15  # of the image's short side
BORDER_PX = 8
MOST = 500


@dataclass(frozen=True, kw_only=True)
class Dust:
    """xy_px (N, 2) centre, diameter_px (N,) of the circle of the same area, depth (N,) share of the light missing at the
    darkest place; the deepest first."""

    xy_px: np.ndarray
    diameter_px: np.ndarray
    depth: np.ndarray


def find_dust(response: np.ndarray, defective: np.ndarray) -> Dust:
    """Shadows in a response map (H, W), mean 1. defective: (H, W) bool, pixels that say nothing of dust."""
    h, w = response.shape
    filled = np.where(defective, np.float32(1), response)
    smooth = cv2.blur(filled, (SIDE_PX, SIDE_PX), borderType=cv2.BORDER_REFLECT)
    del filled
    smooth -= np.float32(typical(smooth))
    limit = core_sigma(smooth, None)
    limit *= -SIGMA
    dark = smooth < np.minimum(limit, np.float32(-LEAST_DEPTH), out=limit)
    dark[:BORDER_PX] = dark[-BORDER_PX:] = dark[:, :BORDER_PX] = dark[:, -BORDER_PX:] = False
    label, count = ndimage.label(dark, np.ones((3, 3)))
    found = []
    for number, place in enumerate(ndimage.find_objects(label), start=1):
        high, wide = (part.stop - part.start for part in place)
        own = label[place] == number
        area = int(np.count_nonzero(own))
        if area < SIDE_PX**2 or area < LEAST_FILL * high * wide or max(high, wide) > WIDEST * min(h, w):
            continue
        depth = np.where(own, -smooth[place], 0)
        y, x = np.average(np.argwhere(own), axis=0, weights=depth[own])
        found.append((x + place[1].start, y + place[0].start, np.sqrt(4 * area / np.pi), depth.max()))
    found = np.array(sorted(found, key=lambda one: -one[3])[:MOST]).reshape(-1, 4)
    return Dust(xy_px=found[:, :2], diameter_px=found[:, 2], depth=found[:, 3])
