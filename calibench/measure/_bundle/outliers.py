"""Outliers: points that miss by more than the rest allows are set aside, and may come back, until none changes sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from .adjust import FINE, Solution, adjust

ROUNDS = 12
MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution


@dataclass(frozen=True, kw_only=True)
class Rejection:
    """sigma: points farther off than this many robust sigma of one coordinate are dropped; of a block at most this share."""

    sigma: float
    most: float


def without_outliers(solution: Solution, rejection: Rejection, *, lens_fixed: bool = False,
                     tolerance: float = FINE, settling: float | None = None) -> Solution:
    """The adjustment with outliers at weight 0, from a first (coarse) solution over all points.

    tolerance: of the adjustment, see `adjust`. settling: a coarser one while points still change sides, which pays where they
    do so for many rounds (stars) and costs an adjustment where they do not (boards); without it, `tolerance`.

    Raises:
        BadInput: the lens that fits folds before a point that counts.
    """
    given, fine = [block.weight for block in solution.blocks], False
    coarse = max(tolerance, settling or tolerance)
    for tried in range(ROUNDS):
        keep = [_inliers(residual, block.weight, weight, rejection)
                for residual, block, weight in zip(solution.residuals_px, solution.blocks, given, strict=True)]
        settled = tried > 0 and all((k == (b.weight > 0)).all() for k, b in zip(keep, solution.blocks, strict=True))
        if settled and fine:
            break
        blocks = [b.weighted(np.where(k, w, 0.0)) for b, k, w in zip(solution.blocks, keep, given, strict=True)]
        fine = settled or coarse == tolerance or tried == ROUNDS - 1
        solution = adjust(solution.intrinsics, blocks, lens_fixed=lens_fixed, tolerance=tolerance if fine else coarse)
    if solution.folds:
        raise BadInput(f"the lens model {solution.intrinsics.model} does not suit this lens: fitted, it folds inside the image",
                       mend="ask for a model of more terms, or for a fisheye")
    return solution


def _inliers(residual_px: np.ndarray, counted: np.ndarray, weight: np.ndarray, rejection: Rejection) -> np.ndarray:
    """(V, P) of the points given (weight > 0): those near enough, and always the best 1 - most of them."""
    there = weight > 0
    size = np.abs(residual_px) * weight[..., None]
    sigma = MAD * np.median(size[counted > 0])
    distance = np.sqrt((size**2).sum(axis=-1))
    near = there & (distance <= rejection.sigma * sigma)
    if near.sum() < (1 - rejection.most) * there.sum():
        near = there & (distance <= np.quantile(distance[there], 1 - rejection.most))
    return near
