"""Inner corners of a checkerboard of which only a part is seen: off the frame, or behind a hand.

The corners seen form a lattice (`_saddles`, `_lattice`). Which part of the board it is, is settled along an axis where the
lattice is as long as the board, or where an end of the board is seen: squares that alternate out to the outermost ones, and
white margin beyond them, all along that side. Where several places remain, the view is refused: on a flat board a
shift by a square looks like another pose, and no residual would tell. A board turned by half is the same board.

A plain checkerboard does not show whether it is mirrored.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from ._lattice import seen_lattice
from ._saddles import sampled
from ._target import Target, Unsettled
from .checkerboard import POINT, TARGET, WINDOWS, points, shown

__all__ = ["POINT", "TARGET", "WINDOWS", "find", "points", "shown"]

NEAR_LINES = 3  # of corners: what lies just beyond the last one is foretold from these
INSIDE, BEYOND = 0.88, 1.12  # squares beyond the last corners: still on the outermost squares, and past them
LEAST_SQUARES = 3  # along a side, to tell an end
SAME_WHITE = 0.1  # of the contrast: the margin is the paper of the white squares


def find(grey: np.ndarray, target: Target) -> np.ndarray | None:
    """Corners (P, 2) px row by row, NaN: not seen; None where no checkerboard is seen.

    Raises:
        Unsettled: a part of a checkerboard is seen, and it is not settled which.
    """
    smooth, by, seen = seen_lattice(grey)
    if seen is None:
        return None
    xy, uv = seen
    ends = _ends(smooth, xy, uv)
    sizes = np.ptp(uv, axis=0) + 1
    places = [(turned, *at) for turned in ((False, True) if target.board[0] != target.board[1] else (False,))
              for at in itertools.product(*(_starts(length, sizes[axis], *ends[axis]) for axis, length in
                                            enumerate(target.board[::-1] if turned else target.board)))]
    if len(places) != 1:
        columns, rows = sizes if (sizes[0] > sizes[1]) == (target.board[0] > target.board[1]) else sizes[::-1]
        raise Unsettled(f"a board is seen of which {columns}x{rows} inner corners show, {len(uv)} of them clearly; " + (
            f"that is no part of {target.board[0]}x{target.board[1]}" if not places else
            "which part that is, is not settled: show one whole row and column, or the white margin at an end of each"))
    (turned, *start), = places
    column, row = (uv + start).T
    if turned:  # the lattice's columns are the board's rows; a quarter turn keeps the order right-handed
        column, row = row, target.board[1] - 1 - column
    out = np.full((target.board[1], target.board[0], 2), np.nan)
    out[row, column] = xy * by + (by - 1) / 2
    return out.reshape(-1, 2)


def _starts(length: int, seen: int, first: bool, last: bool) -> list[int]:
    """Columns of the board at which a lattice of `seen` columns may begin, when its first or last is known to be an end."""
    starts = range(length - seen + 1)
    return [s for s in starts if (not first or s == 0) and (not last or s == length - seen)]


def _ends(smooth: np.ndarray, xy: np.ndarray, uv: np.ndarray) -> list[tuple[bool, bool]]:
    """For columns and rows: whether the lattice's first is the board's, and its last."""
    out = []
    for axis in (0, 1):
        last = int(uv[:, axis].max())
        out.append((_is_end(smooth, xy, uv, axis), _is_end(smooth, xy, np.where(np.arange(2) == axis, last - uv, uv), axis)))
    return out


def _is_end(smooth: np.ndarray, xy: np.ndarray, uv: np.ndarray, axis: int) -> bool:
    """Whether the board ends one square before the first line along an axis."""
    near = uv[:, axis] < NEAR_LINES
    squares = np.arange(uv[:, 1 - axis].max()) + 0.5
    if near.sum() < 2 * NEAR_LINES or len(squares) < LEAST_SQUARES or (np.ptp(uv[near], axis=0) < 1).any():
        return False
    to_image = cv2.findHomography(uv[near].astype(float), xy[near])[0]

    def light(at: float) -> np.ndarray:
        """(squares,) along a line, at that place along the axis."""
        place = np.stack([np.full(len(squares), at), squares], -1)[:, ::1 - 2 * axis]
        return sampled(smooth, cv2.perspectiveTransform(place[None].astype(float), to_image)[0])

    outer, edge, margin = light(-0.5), light(-INSIDE), light(-BEYOND)
    if not np.isfinite([outer, edge, margin]).all():
        return False
    dark = np.arange(len(squares)) % 2 == (0 if outer[::2].mean() < outer[1::2].mean() else 1)
    # brightness changes along the side: white as the nearest white squares are
    white = np.interp(squares, squares[~dark], outer[~dark])
    contrast = white.mean() - outer[dark].mean()
    middle = white - contrast / 2
    return bool(contrast > 0 and ((outer < middle) == dark).all() and ((edge < middle) == dark).all()
                and (np.abs(margin - white) < SAME_WHITE * contrast).all())
