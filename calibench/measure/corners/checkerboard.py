"""Inner corners of a checkerboard from its quads (OpenCV). Fast; where it fails, `checkerboard_sectors` may see the board.

A plain checkerboard does not show whether it is mirrored.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._lattice import seen_lattice
from ._target import Target, right_handed
from ._target import grid as points

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

TARGET = "checkerboard"
POINT = "inner corners, where four squares meet"
WINDOWS = (0.1, 0.25)  # wider ones gain little light, and the errors of the print come in
NEARLY_ALL = 0.9  # of a grid's corners: some are behind a reflection
FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE  # no fast check: it misses tilted boards


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, all of them; None where the board is not seen whole."""
    found, corners = cv2.findChessboardCorners(grey, target.board, flags=FLAGS)
    return right_handed(corners.astype(float), target.board) if found else None


def shown(grey: np.ndarray, target: Target) -> tuple[int, int] | None:
    """Columns and rows of the corners that a view shows, turned as the target said; None where they are no whole grid."""
    _, _, seen = seen_lattice(grey)
    if seen is None:
        return None
    size = np.sort(np.ptp(seen[1], axis=0) + 1)
    if len(seen[1]) < NEARLY_ALL * size.prod():
        return None
    columns, rows = size if target.board[0] < target.board[1] else size[::-1]
    return int(columns), int(rows)
