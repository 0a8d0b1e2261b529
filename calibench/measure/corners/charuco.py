"""Inner corners of a ChArUco board: its markers say which corner is which, so a part of the board is enough."""

from __future__ import annotations

import cv2
import numpy as np

from ...errors import BadInput
from ._target import Target
from ._target import grid as points

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

TARGET = "charuco"
POINT = "inner corners, where four squares meet"
WINDOWS = (0.1, 0.2)  # the marker's black border is as symmetric as the board; what it says inside is not
LEAST_CORNERS = 9
LEAST_LINES = 2


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, NaN: not seen; None where too few are.

    Raises:
        BadInput: the image is mirrored, or the board cannot be made of this dictionary.
    """
    found = _corners(grey, target)
    if found is None and _corners(np.ascontiguousarray(grey[:, ::-1]), target) is not None:
        raise BadInput("the image is mirrored: its markers can be read only when it is flipped",
                       mend="flip the frames, or take the mirror out of the light path")
    return found


def shown(grey: np.ndarray, target: Target) -> None:
    """Not known: the markers say which corner is which, not how many there are."""


def _corners(grey: np.ndarray, target: Target) -> np.ndarray | None:
    for legacy in (False, True):  # boards made before OpenCV 4.6 start with a marker in the corner
        identity = cv2.aruco.CharucoDetector(_board(target, legacy)).detectBoard(grey)
        if identity[1] is not None and len(identity[1]) >= LEAST_CORNERS:
            out = np.full((target.board[0] * target.board[1], 2), np.nan)
            out[identity[1].ravel()] = identity[0].reshape(-1, 2)
            lines = np.isfinite(out[:, 0]).reshape(target.board[::-1])
            if min(lines.any(axis=0).sum(), lines.any(axis=1).sum()) >= LEAST_LINES:
                return out
    return None


def _board(target: Target, legacy: bool) -> cv2.aruco.CharucoBoard:
    name = target.dictionary.upper()
    number = getattr(cv2.aruco, name if name.startswith("DICT_") else f"DICT_{name}", None)
    if number is None:
        known = sorted(n.removeprefix("DICT_") for n in dir(cv2.aruco) if n.startswith("DICT_"))
        raise BadInput(f"no marker dictionary '{target.dictionary}'", mend=f"choose one of: {', '.join(known)}")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    squares = (target.board[0] + 1, target.board[1] + 1)
    markers, there = squares[0] * squares[1] // 2, len(dictionary.bytesList)
    if markers > there:
        raise BadInput(f"{squares[0]}x{squares[1]} squares carry {markers} markers, {target.dictionary} has {there}",
                       mend="give the --dictionary that is printed on the board, like 5X5_250")
    marker_mm = 0.75 * target.square_mm if target.marker_mm is None else target.marker_mm
    if not 0 < marker_mm < target.square_mm:
        raise BadInput(f"markers of {marker_mm:g} mm do not fit squares of {target.square_mm:g} mm")
    board = cv2.aruco.CharucoBoard(squares, target.square_mm, marker_mm, dictionary)
    board.setLegacyPattern(legacy)
    return board
