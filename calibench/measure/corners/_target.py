"""What stands before the camera: a target with columns x rows points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


class Unsettled(Exception):
    """A part of the target is seen, and it is not settled which part; the message says what is seen."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """board: points (columns, rows): inner corners, or dots. square_mm: their distance along a row (asymmetric dots: half of
    it). marker_mm: side of the markers inside the squares, None: three quarters of a square. dictionary: of the markers, as
    OpenCV names it.
    """

    board: tuple[int, int]
    square_mm: float = 25.0
    marker_mm: float | None = None
    dictionary: str = "DICT_4X4_50"


def grid(board: tuple[int, int]) -> np.ndarray:
    """(P, 2) columns and rows of a board's points, row by row."""
    return np.stack(np.meshgrid(np.arange(board[0]), np.arange(board[1])), axis=-1).reshape(-1, 2).astype(float)


def right_handed(xy_px: np.ndarray, board: tuple[int, int]) -> np.ndarray:
    """Points (P, 2) so ordered that columns x rows point away from the camera: a normal means the same in every view."""
    rows = xy_px.reshape(board[1], board[0], 2)
    return (rows[:, ::-1] if turns(xy_px, board) < 0 else rows).reshape(-1, 2)


def turns(xy_px: np.ndarray, board: tuple[int, int]) -> float:
    """Sense of rotation from columns to rows: positive where the image shows them as they are printed, negative mirrored."""
    rows = xy_px.reshape(board[1], board[0], 2)
    along, down = rows[0, -1] - rows[0, 0], rows[-1, 0] - rows[0, 0]
    return float(along[0] * down[1] - along[1] * down[0])


def largest_found(find: Callable, grey: np.ndarray, target: Target) -> tuple[int, int] | None:
    """The size of the grid that `find` sees: the one said, or a neighbour of it, and from there ever larger ones."""
    def seen(size: tuple[int, int]) -> bool:
        return find(grey, dataclasses.replace(target, board=size)) is not None

    columns, rows = target.board
    around = sorted(((columns + i, rows + j) for i in (-1, 0, 1) for j in (-1, 0, 1)), key=lambda s: s != target.board)
    size = next((s for s in around if min(s) > 2 and seen(s)), None)
    while size and (larger := next((s for s in ((size[0] + 1, size[1]), (size[0], size[1] + 1)) if seen(s)), None)):
        size = larger
    return size
