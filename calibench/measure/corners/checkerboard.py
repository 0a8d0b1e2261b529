"""Inner corners of a checkerboard from its quads (OpenCV). Fast; where it fails, `checkerboard_sectors` may see the board.

A plain checkerboard does not show whether it is mirrored.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._target import Target, right_handed
from ._target import grid as points

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points"]

TARGET = "checkerboard"
POINT = "inner corners, where four squares meet"
WINDOWS = (0.1, 0.25)  # wider ones gain little light, and the errors of the print come in
FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE  # no fast check: it misses tilted boards


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, all of them; None where the board is not seen whole."""
    found, corners = cv2.findChessboardCorners(grey, target.board, flags=FLAGS)
    return right_handed(corners.astype(float), target.board) if found else None
