"""Block: views of one kind of target and how they are posed; many blocks stand in one problem and share the lens.

A block holds V views of up to P points and states, for a lens, how its residuals change with
- the lens (fx, fy, cx, cy, terms), common to all blocks,
- what it has of its own that all its views share (`own` parameters; a board's bow),
- each view's pose (6 for a board, 3 for the sky).
The views touch each other only through the first two, which is what `adjust` lives on.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from ...geometry import projection
from ...records import Intrinsics

POINTS_AT_A_TIME = 4000


class Block(Protocol):
    """xy_px (V, P, 2): measured points. weight (V, P): 1 / sigma of a coordinate, 0 for what is absent or an outlier."""

    xy_px: np.ndarray
    weight: np.ndarray

    @property
    def own_count(self) -> int:
        """Number of parameters that the block's views share, beside the lens."""

    @property
    def pose_count(self) -> int:
        """Number of pose parameters of one view."""

    def to_camera(self) -> np.ndarray:
        """Points (3, V, P) in camera axes."""

    def fill(self, rows: np.ndarray, xyz: np.ndarray, by_v: tuple) -> None:
        """Write into rows (V, own + pose, 2, P) the weighted derivatives of the pixels by own and pose parameters.

        xyz: what `to_camera` gave. by_v: for column and row of the image, the weighted derivatives (V, P) by X, Y, Z there.
        """

    def moved(self, own: np.ndarray, poses: np.ndarray) -> Self:
        """The block after a step: own (own_count,), poses (V, pose_count)."""

    def take(self, views: np.ndarray | slice) -> Self:
        """The block of these views only."""

    def weighted(self, weight: np.ndarray) -> Self:
        """The block with other weights (V, P)."""


def linearised(block: Block, lens: Intrinsics, *, lens_free: bool,
               past_fold: bool = False) -> tuple[np.ndarray, float, np.ndarray] | None:
    """Each view's products of its derivatives and residuals; None where a point that counts is not visible.

    The views are taken some at a time, so that the derivatives stay in the processor's cache.

    Args:
        lens_free: lens and own parameters take part; else only the poses do. past_fold: see `projection.bend`.

    Returns:
        gram (V, n, n + 1): J [J r]^T over the view's points, rows of J: lens, own, pose; r the weighted residual.
        cost: weighted sum of squares. residual_px (V, 2, P): measured minus projected, not weighted.
    """
    views, points = block.weight.shape
    n = block.pose_count + (len(lens.parameters) + block.own_count if lens_free else 0)
    gram, residual, cost = np.empty((views, n, n + 1)), np.empty((views, 2, points)), 0.0
    some = max(1, POINTS_AT_A_TIME // points)
    rows = np.empty((min(some, views), len(lens.parameters) + block.own_count + block.pose_count + 1, 2, points))
    for first in range(0, views, some):
        part = np.s_[first:first + some]
        if not _fill(block.take(part), lens, rows[:views - first], residual[part], past_fold):
            return None
        flat = rows[:views - first, -n - 1:].reshape(-1, n + 1, 2 * points)
        np.matmul(flat[:, :-1], flat.swapaxes(1, 2), out=gram[part])
        cost += float(np.vdot(flat[:, -1], flat[:, -1]))
    return gram, cost, residual


def _fill(block: Block, lens: Intrinsics, rows: np.ndarray, residual: np.ndarray, past_fold: bool) -> bool:
    """Write rows (V, lens + own + pose + 1, 2, P) and residuals (V, 2, P); False if a point that counts is out of sight."""
    xyz = block.to_camera()
    (x, y), by_v, by_terms = projection.bend(lens, *xyz, jacobian=True, past_fold=past_fold)
    weight = block.weight
    scale_x, scale_y = weight * lens.fx_px, weight * lens.fy_px
    rows[:, :4] = 0
    np.multiply(weight, x, out=rows[:, 0, 0])
    np.multiply(weight, y, out=rows[:, 1, 1])
    rows[:, 2, 0] = rows[:, 3, 1] = weight
    for i, (by_x, by_y) in enumerate(by_terms, start=4):
        np.multiply(scale_x, by_x, out=rows[:, i, 0])
        np.multiply(scale_y, by_y, out=rows[:, i, 1])
    across, column = by_v[0], x
    if lens.skew_px is not None:
        slant = lens.skew_px / lens.fx_px  # column = fx (x' + slant y') + cx
        for i, (_, by_y) in enumerate(by_terms, start=4):
            rows[:, i, 0] += lens.skew_px * weight * by_y
        rows[:, 4 + len(by_terms)] = 0
        np.multiply(weight, y, out=rows[:, 4 + len(by_terms), 0])
        across, column = tuple(by_x + slant * by_y for by_x, by_y in zip(*by_v, strict=True)), x + slant * y
    block.fill(rows[:, len(lens.parameters):-1], xyz, (tuple(scale_x * d for d in across), tuple(scale_y * d for d in by_v[1])))
    np.subtract(block.xy_px[..., 0], lens.fx_px * column + lens.cx_px, out=residual[:, 0])
    np.subtract(block.xy_px[..., 1], lens.fy_px * y + lens.cy_px, out=residual[:, 1])
    np.multiply(residual, weight[:, None], out=rows[:, -1])
    if not np.isfinite(rows[:, -1].sum()):
        unseen = ~np.isfinite(residual).all(axis=1)
        if (unseen & (weight > 0)).any():
            return False
        np.moveaxis(rows, 3, 1)[unseen] = 0
    return True
