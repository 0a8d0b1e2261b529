"""Middles of the dots of an asymmetric grid: every other row is shifted by half the distance between dots.

board: dots in a row x rows, as in OpenCV's 4x11. square_mm is half the distance between the dots of a row, which is the
distance between rows. The dots' middles are treated as in `circles`. With an even number of rows a mirrored image is seen;
with an odd one the grid is its own mirror image.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...errors import BadInput
from ._target import Target, grid, largest_found, turns
from .circles import POINT, WINDOWS

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

TARGET = "circles_asymmetric"


def points(board: tuple[int, int]) -> np.ndarray:
    """(P, 2) places of the dots, row by row."""
    column, row = grid(board).T
    return np.stack([2 * column + row % 2, row], axis=-1)


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Middles (P, 2) px row by row, all of them; None where the grid is not seen whole.

    Raises:
        BadInput: the image is mirrored.
    """
    found, middles = cv2.findCirclesGrid(grey, target.board, flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    if not found:
        return None
    rows = middles.astype(float).reshape(target.board[1], target.board[0], 2)
    if turns(rows, target.board) < 0:
        if target.board[1] % 2 == 0:
            raise BadInput("the image is mirrored: the shift of its rows goes the other way",
                           mend="flip the frames, or take the mirror out of the light path")
        rows = rows[::-1]
    return rows.reshape(-1, 2)


def shown(grey: np.ndarray, target: Target) -> tuple[int, int] | None:
    """Columns and rows of the dots, when the grid seen is the one said, a neighbour of it, or a larger one around it."""
    return largest_found(find, grey, target)
