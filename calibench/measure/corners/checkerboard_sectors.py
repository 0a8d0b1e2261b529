"""Inner corners of a checkerboard by its sectors (OpenCV's SB: Duda and Frese 2018): slow, for blurred and badly lit views.

A plain checkerboard does not show whether it is mirrored.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._target import Target, right_handed
from .checkerboard import POINT, TARGET, WINDOWS, points, shown

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, all of them; None where the board is not seen whole."""
    found, corners = cv2.findChessboardCornersSB(grey, target.board, flags=FLAGS)
    return right_handed(corners.astype(float), target.board) if found else None
