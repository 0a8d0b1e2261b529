"""Inner corners of a checkerboard from its quads (OpenCV). Fast; where it fails, `checkerboard_sectors` may see the board.

A plain checkerboard does not show whether it is mirrored.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._target import Target, right_handed
from ._target import grid as points

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "may_go_on", "points"]

TARGET = "checkerboard"
POINT = "inner corners, where four squares meet"
WINDOWS = (0.1, 0.25)  # wider ones gain little light, and the errors of the print come in
FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE  # no fast check: it misses tilted boards


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, all of them; None where the board is not seen whole."""
    found, corners = cv2.findChessboardCorners(grey, target.board, flags=FLAGS)
    return right_handed(corners.astype(float), target.board) if found else None


def may_go_on(grey: np.ndarray, xy_px: np.ndarray, board: tuple[int, int]) -> bool:
    """Whether squares alternate beyond the outermost ones as they do inside."""
    to_image = cv2.findHomography(points(board), xy_px)[0]
    columns, rows = board
    along, down = np.arange(columns - 1) + 0.5, np.arange(rows - 1) + 0.5
    inside = abs(_alternation(grey, to_image, *np.meshgrid(along, down)))
    # near the outermost squares of the board said: those of the true board may be cut narrower
    beyond = ((along, -1.25), (along, rows + 0.25), (-1.25, down), (columns + 0.25, down))
    return any(abs(_alternation(grey, to_image, *np.broadcast_arrays(u, v))) > 0.5 * inside for u, v in beyond)


def _alternation(grey: np.ndarray, to_image: np.ndarray, u: np.ndarray, v: np.ndarray) -> float:
    """Amplitude of black against white over places u, v in squares, as far as they are in the image."""
    x, y, scale = to_image @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    column, row = np.rint([x / scale, y / scale]).astype(int)
    there = (column >= 0) & (row >= 0) & (column < grey.shape[1]) & (row < grey.shape[0])
    if there.sum() < 3:
        return 0.0
    light = grey[row[there], column[there]].astype(float)
    sign = np.where((np.floor(u) + np.floor(v)).ravel() % 2 == 0, 1.0, -1.0)[there]
    return float(np.mean(sign * (light - light.mean())))
