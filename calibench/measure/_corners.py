"""Checkerboard corners: find the board, refine each corner in a window that fits its own surroundings.

1. OpenCV's quad search finds the board; where it fails, the sector-based search (SB) tries.
2. Two refiners give sub-pixel corners of the same board: `gradient` (cornerSubPix) and `sector` (SB's own).
3. The caller keeps the refiner that leaves the smaller residual: sharp views favour the first, blurred ones the second.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..errors import BadInput
from ..records import Frame

REFINERS = ("gradient", "sector")
QUADS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE  # no fast check: it misses tilted boards
SECTORS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
DEMOSAIC = {"RGGB": cv2.COLOR_BayerRGGB2GRAY, "BGGR": cv2.COLOR_BayerBGGR2GRAY,
            "GRBG": cv2.COLOR_BayerGRBG2GRAY, "GBRG": cv2.COLOR_BayerGBRG2GRAY}


def grey_image(frame: Frame) -> np.ndarray:
    """(H, W) uint8 for the detectors; deeper data are stretched between their 0.1 and 99.9 percentiles."""
    data = frame.data
    if data.dtype != np.uint8:
        low, high = np.percentile(data[::4, ::4], (0.1, 99.9))
        data = np.clip((data - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)
    return cv2.cvtColor(data, DEMOSAIC[frame.bayer_pattern]) if frame.bayer_pattern else np.ascontiguousarray(data)


def find_board(grey: np.ndarray, board: tuple[int, int]) -> np.ndarray | None:
    """Corners (rows * columns, 2) in px to about a pixel, row by row, or None where the board is not seen.

    The order is right-handed (columns x rows point away from the camera), so that a board normal means the same in
    every view. A mirrored print is not told from a true one: a plain checkerboard does not show it.
    """
    found, corners = cv2.findChessboardCorners(grey, board, flags=QUADS)
    if not found:
        found, corners = cv2.findChessboardCornersSB(grey, board, flags=SECTORS)
    return _right_handed(corners, board) if found else None


def _right_handed(corners: np.ndarray, board: tuple[int, int]) -> np.ndarray:
    grid = corners.reshape(board[1], board[0], 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid = grid[:, ::-1]
    return grid.reshape(-1, 2)


def spacing_px(corners: np.ndarray, board: tuple[int, int]) -> np.ndarray:
    """Distance (P,) of each corner to its nearest neighbour on the board, px."""
    grid = corners.reshape(board[1], board[0], 2)
    nearest = np.full((board[1], board[0]), np.inf)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    for side, step in ((np.s_[:, 1:], across), (np.s_[:, :-1], across), (np.s_[1:], down), (np.s_[:-1], down)):
        nearest[side] = np.minimum(nearest[side], step)
    return nearest.ravel()


def refine(grey: np.ndarray, corners: np.ndarray, board: tuple[int, int], refiner: str, window: float) -> np.ndarray | None:
    """Sub-pixel corners (P, 2), or None where this refiner does not see the board.

    Args:
        window: half width of the `gradient` window as a fraction of the local corner spacing. A fixed window swallows
            the next corner on a far board and wastes light on a near one.
    """
    spacing = spacing_px(corners, board)
    if refiner == "sector":
        return _sector_corners(grey, corners, board, spacing)
    half = np.maximum(2, np.rint(window * spacing)).astype(int)
    out = corners.astype(np.float32)
    for size in np.unique(half):
        rows = half == size
        out[rows] = cv2.cornerSubPix(grey, out[rows].copy(), (int(size), int(size)), (-1, -1), STOP)
    return out.astype(float)


def _sector_corners(grey: np.ndarray, like: np.ndarray, board: tuple[int, int], spacing: np.ndarray) -> np.ndarray | None:
    """SB's corners in the order of `like`, searched for around it only; None if it sees none or another board."""
    margin = 2 * spacing.max()
    x0, y0 = np.maximum(like.min(axis=0) - margin, 0).astype(int)
    x1, y1 = np.ceil(like.max(axis=0) + margin).astype(int)
    found, corners = cv2.findChessboardCornersSB(np.ascontiguousarray(grey[y0:y1, x0:x1]), board, flags=SECTORS)
    if not found:
        return None
    corners = _right_handed(corners, board).astype(float) + (x0, y0)
    corners = min((corners, corners[::-1]), key=lambda c: np.linalg.norm(c - like))
    return corners if (np.linalg.norm(corners - like, axis=1) < 0.5 * spacing).all() else None


def check_board_size(found: Sequence[np.ndarray], missed: Sequence[np.ndarray], board: tuple[int, int]) -> None:
    """Ask whether the board is larger than said (on views where it was found) or a neighbouring size (where it was not).

    Raises:
        BadInput: another size is what most of the probed views show.
    """
    columns, rows = board
    size, views = board, list(found or missed)
    if not found:
        around = ((columns + i, rows + j) for i in (1, 0, -1) for j in (1, 0, -1))
        size = next((s for s in around if s != board and min(s) > 2 and _seen(views, s)), board)
    while larger := next((s for s in ((size[0] + 1, size[1]), (size[0], size[1] + 1)) if _seen(views, s)), None):
        size = larger
    if size != board:
        raise BadInput(f"found {size[0]}x{size[1]}, you said {columns}x{rows}: count inner corners, where four squares meet",
                       mend=f"give --board {size[0]}x{size[1]}")


def _seen(views: Sequence[np.ndarray], size: tuple[int, int]) -> bool:
    """Whether most of the views show a board of this size."""
    return sum(cv2.findChessboardCorners(grey, size, flags=QUADS)[0] for grey in views) * 2 > len(views)
