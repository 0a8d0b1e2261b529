"""Middles of the dots of a symmetric grid.

The middle of a dot's image is not the image of its middle: perspective and lens shift it by up to some tenths of a pixel.
The refiner knows the bend of the map from board to image and takes this out without being told the dots' size. The grid
does not show whether it is mirrored.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._target import Target, largest_found, right_handed
from ._target import grid as points

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

TARGET = "circles"
POINT = "dots"
WINDOWS = (0.5, 0.5)  # the whole dot, and nothing of the next


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Middles (P, 2) px row by row, all of them; None where the grid is not seen whole."""
    found, middles = cv2.findCirclesGrid(grey, target.board, flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    return right_handed(middles.astype(float), target.board) if found else None


def shown(grey: np.ndarray, target: Target) -> tuple[int, int] | None:
    """Columns and rows of the dots, when the grid seen is the one said, a neighbour of it, or a larger one around it."""
    return largest_found(find, grey, target)
