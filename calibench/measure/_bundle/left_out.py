"""Each view left out: how far the lens would move, and how well it would foresee that view. No adjustment is done again.

With each view's information H_v and score g_v (poses eliminated, their sum at the optimum 0), the others alone have their
optimum, to first order, at
    d_v = -(H - H_v)^-1 g_v
and the view left out, its pose fitted to that lens, then costs
    c_v - 2 g_v d_v + d_v H_v d_v.
(Belsley, Kuh and Welsch 1980, Regression Diagnostics, sec. 2.1, for a group of rows.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from ...geometry.projection_error import direction_jacobian
from ...records import Intrinsics
from .adjust import Solution

HOPELESS = 1e-10  # of the leverage: a view without which a parameter is not determined


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """step (V, S): change of the shared parameters without the view. square_px2 (V,): mean square of its points that count,
    under the lens of the others, weighted as in the adjustment. Infinite where the others do not determine the lens."""

    step: np.ndarray
    square_px2: np.ndarray
    weight: np.ndarray

    @property
    def rms_px(self) -> float:
        """Over all points that count."""
        return float(np.sqrt(self.square_px2 @ self.weight / self.weight.sum()))


def left_out(solution: Solution) -> LeftOut:
    """What each view (of all blocks in a row) means to the lens."""
    total = solution.information.sum(axis=0)
    scale = 1 / np.sqrt(np.diag(total))
    value, axes = np.linalg.eigh(total * np.outer(scale, scale))
    root = scale[:, None] * axes / np.sqrt(np.maximum(value, len(value) * np.finfo(float).eps * value[-1]))
    # in the axes where the total is 1, what the others know is 1 less the view's leverage
    leverage, turn = np.linalg.eigh(root.T @ solution.information @ root)
    others = 1 - leverage
    along = np.einsum("vij,vi->vj", turn, solution.score @ root)
    step = -along / np.where(others > HOPELESS, others, np.nan)
    square = np.concatenate([(np.sum(r**2, axis=-1) * b.weight**2).sum(axis=1)
                             for r, b in zip(solution.residuals_px, solution.blocks, strict=True)])
    weight = np.concatenate([(b.weight**2).sum(axis=1) for b in solution.blocks])
    cost = square + np.sum(leverage * step**2 - 2 * along * step, axis=1)
    lost = np.isnan(step).any(axis=1)
    moved = np.where(lost[:, None], np.inf, np.einsum("vij,vj->vi", turn, step) @ root.T)
    return LeftOut(step=moved, square_px2=np.where(lost, np.inf, cost / np.maximum(weight, 1e-300)), weight=weight)


def effect_sd(left: LeftOut, lens: Intrinsics) -> np.ndarray:
    """(V,) the largest move of the direction that a corner of the image sees, in standard deviations of that direction.

    The best common turn is taken out of both. NaN where the lens has no direction for a corner.
    """
    w, h = lens.image_size_px
    try:
        _, by_lens = direction_jacobian(lens, np.array([[0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]], float))
    except BadInput:
        return np.full(len(left.step), np.nan)
    move = np.linalg.norm(np.einsum("nip,vp->vni", by_lens, left.step[:, :by_lens.shape[2]]), axis=2)
    sd = np.sqrt(np.einsum("nip,pq,niq->n", by_lens, lens.covariance, by_lens))
    return (move / sd).max(axis=1)
