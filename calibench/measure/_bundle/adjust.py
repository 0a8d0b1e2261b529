"""Adjustment of one lens and blocks of views: Levenberg-Marquardt on the block-arrow normal equations.

1. Linearise: each view gives one small matrix of products (block.linearised).
2. Eliminate each view's pose from its own equations (Schur complement, batched over views).
3. Solve the one small dense system of lens and own parameters; each view's pose follows from it.
4. Take the step if it lowers the cost, else damp more; stop when the step foreseen would no longer matter.
Time and memory grow linearly with the number of views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import BadInput
from ...records import Intrinsics
from .block import Block, linearised

MAX_STEPS = 60
MAX_DAMPING = 1e8
FINE = 1e-8  # of the cost: what the last step may foresee; of 40000 residuals that step is 0.02 sigma, its error far less
COARSE = 1e-3  # enough to tell outliers


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Lens and blocks at the optimum.

    residuals_px: of each block (V, P, 2), measured minus projected, whatever its weight. cost: weighted sum of squares.
    information (V, S, S) and score (V, S): each view's share (views of all blocks in a row) of the normal equations of the S
    shared parameters (lens first, then what the blocks own), poses eliminated. folds: the lens folds before a point that
    counts: it fits, but cannot be inverted and is of no use.
    """

    intrinsics: Intrinsics
    blocks: tuple[Block, ...]
    residuals_px: tuple[np.ndarray, ...]
    cost: float
    information: np.ndarray
    score: np.ndarray
    folds: bool

    @property
    def residual_px(self) -> np.ndarray:
        """Residuals (V, P, 2) of a problem with one block."""
        (residual,) = self.residuals_px
        return residual

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates that count, less the parameters they determine."""
        counted = [b.weight > 0 for b in self.blocks]
        poses = sum(b.pose_count * int(c.any(axis=1).sum()) for b, c in zip(self.blocks, counted, strict=True))
        return 2 * sum(int(c.sum()) for c in counted) - poses - self.score.shape[1]


@dataclass(frozen=True)
class _Normal:
    """Normal equations of a block: gram (V, n, n + 1), right side last; its first rows are those `shared` of the problem."""

    shared: np.ndarray
    gram: np.ndarray
    pose_count: int

    def reduced(self, damping: float) -> tuple[np.ndarray, ...]:
        """Poses eliminated: information (V, s, s), score (V, s); poses = at (V, d) - into (V, d, s) @ shared."""
        s = len(self.shared)
        c = self.gram[:, s:, s:-1].copy()
        diagonal = np.arange(self.pose_count)
        c[:, diagonal, diagonal] *= 1 + damping
        c[:, diagonal, diagonal] += c[:, diagonal, diagonal] == 0  # a view of which nothing counts stays where it is
        right = np.concatenate([self.gram[:, s:, :s], self.gram[:, s:, -1:]], axis=2)
        solved = np.linalg.solve(c, right)
        taken = right[:, :, :s].swapaxes(1, 2) @ solved
        return self.gram[:, :s, :s] - taken[:, :, :s], self.gram[:, :s, -1] - taken[:, :, s], solved[:, :, :s], solved[:, :, s]


@dataclass(frozen=True)
class _State:
    lens: Intrinsics
    blocks: tuple[Block, ...]
    normals: tuple[_Normal, ...]
    residuals: tuple[np.ndarray, ...]
    shared_count: int
    cost: float
    folds: bool


def adjust(lens: Intrinsics, blocks: Sequence[Block], *, lens_fixed: bool = False, tolerance: float = FINE,
           past_fold: bool = False) -> Solution:
    """Least squares over the lens, what the blocks own, and all poses, from the values given.

    Args:
        lens_fixed: poses only (for views held out); lens and own parameters stay.
        tolerance: stop after the step that foresees less than this fraction of the cost.
        past_fold: the lens may begin to fold before a point that counts (a first guess of few terms has to, where the image
            is wide); without it only a lens that folds from the start may go on so.

    Raises:
        BadInput: the normal equations are singular, or a point that counts is not visible at the start.
    """
    state = _state(lens, tuple(blocks), lens_fixed, past_fold=True)
    if state is None:
        raise BadInput("a first guess of a view's pose could not be made", mend="leave out blurred or partly hidden views")
    damping, last = 1e-4, False
    for _ in range(MAX_STEPS):
        shared, poses, foreseen = _step(state, damping)
        last = foreseen <= tolerance * state.cost
        trial = _moved(state, shared, poses, lens_fixed, past_fold=past_fold or state.folds)
        if trial is None or not trial.cost <= state.cost:
            if last:  # nothing but rounding is left to gain
                break
            damping *= 10
            if damping > MAX_DAMPING:
                break
            continue
        state, damping = trial, damping / 10
        if last:
            break
    return _solution(state)


def evaluated(lens: Intrinsics, blocks: Sequence[Block]) -> Solution:
    """Residuals, information and score at the values given, no step taken.

    Raises:
        BadInput: a point that counts is not visible.
    """
    state = _state(lens, tuple(blocks), lens_fixed=False, past_fold=False)
    if state is None:
        raise BadInput("a point is out of the lens's sight")
    return _solution(state)


def _solution(state: _State) -> Solution:
    information, score = [], []
    for normal in state.normals:
        reduced, of_score, *_ = normal.reduced(0.0)
        information.append(_spread(reduced, normal.shared, state.shared_count))
        score.append(_spread(of_score, normal.shared, state.shared_count))
    return Solution(intrinsics=state.lens, blocks=state.blocks, cost=state.cost, information=np.concatenate(information),
                    residuals_px=tuple(r.swapaxes(1, 2) for r in state.residuals), score=np.concatenate(score),
                    folds=state.folds)


def _state(lens: Intrinsics, blocks: tuple[Block, ...], lens_fixed: bool, *, past_fold: bool) -> _State | None:
    """Linearised at these values; None where a point that counts is out of sight."""
    state = _linear_state(lens, blocks, lens_fixed, folds=False)
    return _linear_state(lens, blocks, lens_fixed, folds=True) if state is None and past_fold else state


def _linear_state(lens: Intrinsics, blocks: tuple[Block, ...], lens_fixed: bool, *, folds: bool) -> _State | None:
    lens_count = 0 if lens_fixed else len(lens.parameters)
    at, normals, residuals, cost = lens_count, [], [], 0.0
    for block in blocks:
        own = 0 if lens_fixed else block.own_count
        made = linearised(block, lens, lens_free=not lens_fixed, past_fold=folds)
        if made is None:
            return None
        normals.append(_Normal(np.r_[0:lens_count, at:at + own], made[0], block.pose_count))
        cost += made[1]
        residuals.append(made[2])
        at += own
    return _State(lens, blocks, tuple(normals), tuple(residuals), at, cost, folds)


def _spread(of_block: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """(V, s, s) or (V, s) of a block's shared parameters at their places among all `count`."""
    if len(rows) == count:
        return of_block
    out = np.zeros((len(of_block), *(count,) * (of_block.ndim - 1)))
    out[(np.s_[:], rows) if of_block.ndim == 2 else (np.s_[:], rows[:, None], rows)] = of_block
    return out


def _step(state: _State, damping: float) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Damped step of the shared parameters (S,) and of each block's poses, and the fall of the cost that it foresees.

    Damping scales with each diagonal (Marquardt 1963).
    """
    count = state.shared_count
    total, score = np.zeros((count, count)), np.zeros(count)
    foreseen, solved = 0.0, []
    try:
        for normal in state.normals:
            reduced, of_score, into, at = normal.reduced(damping)
            rows = normal.shared
            total[rows[:, None], rows] += reduced.sum(axis=0)
            score[rows] += of_score.sum(axis=0)
            diagonal = np.arange(len(rows))
            total[rows, rows] += damping * normal.gram[:, diagonal, diagonal].sum(axis=0)
            solved.append((into, at))
        scale = 1 / np.sqrt(np.diag(total).clip(1e-300))
        shared = scale * np.linalg.solve(total * np.outer(scale, scale), scale * score)
    except np.linalg.LinAlgError as error:
        raise BadInput("the views do not determine the lens: the normal equations are singular",
                       mend="take more views, tilted 20 to 45 degrees about both axes, that fill the image") from error
    poses = []
    for normal, (into, at) in zip(state.normals, solved, strict=True):
        s = len(normal.shared)
        poses.append(at - into @ shared[normal.shared])
        foreseen += np.sum(normal.gram[:, :s, -1].sum(axis=0) * shared[normal.shared])
        foreseen += np.sum(normal.gram[:, s:, -1] * poses[-1])
    return shared, poses, float(foreseen)


def _moved(state: _State, shared: np.ndarray, poses: list[np.ndarray], lens_fixed: bool, *, past_fold: bool) -> _State | None:
    """State after a step; None where the step leaves the possible (a negative focal length, a point out of sight)."""
    lens = state.lens
    if not lens_fixed:
        p = lens.parameters + shared[:len(lens.parameters)]
        if not (np.isfinite(p).all() and p[0] > 0 and p[1] > 0):
            return None
        lens = lens.at(p)
    own = [shared[n.shared[n.shared >= len(lens.parameters)]] for n in state.normals]
    blocks = tuple(b.moved(o, p) for b, o, p in zip(state.blocks, own, poses, strict=True))
    return _state(lens, blocks, lens_fixed, past_fold=past_fold)
