"""Lens from identified stars of many frames: adjustment without what does not fit, with the error that centroids miss.

The spots' covariance is the random part (photons, read noise). What comes on top - pixel phase, a lens finer than its model,
catalogue errors - is one more standard deviation, the same for all stars, chosen so that chi-square is what it should be;
without it a few bright stars would settle everything.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import BadInput
from ..records import Identification, Intrinsics
from ._board_lens import with_model
from ._bundle import covariance
from ._bundle.adjust import COARSE, FINE, Solution, adjust, evaluated
from ._bundle.outliers import Rejection, without_outliers
from ._bundle.star_frames import StarFrames

SETTLING = 1e-5  # of the cost: what a step may foresee while stars still change sides, and where a lens only serves to compare
FIRST_EXTRA_SD_PX = 0.3
ROUNDS = 4
SETTLED = 0.01
FOLDS = 5
MIN_FRAMES = 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class StarSolution:
    """Solution over the kept frames; kept (V,) of those given; extra_sd_px beyond the centroids' own errors."""

    solution: Solution
    kept: np.ndarray
    extra_sd_px: float

    @property
    def frames(self) -> StarFrames:
        (frames,) = self.solution.blocks
        return frames


def solve(lens: Intrinsics, found: Sequence[Identification], model: str, *, rejection: Rejection,
          worst_frame: float, tolerance: float = FINE) -> StarSolution:
    """Lens and attitudes from a first guess of the lens.

    Args:
        worst_frame: a frame is dropped whose median residual exceeds the median frame's by this factor. tolerance: of the
            last adjustment, see `adjust`.

    Raises:
        BadInput: the stars do not determine the lens, or the guess has no direction for a spot.
    """
    kept = np.ones(len(found), bool)
    while True:
        frames = StarFrames.of(lens, [f for f, k in zip(found, kept, strict=True) if k])
        first = adjust(with_model(lens, model), [_weighted(frames, frames, FIRST_EXTRA_SD_PX)], tolerance=COARSE)
        distance = np.where(frames.weight > 0, np.linalg.norm(first.residual_px, axis=-1), np.nan)
        typical = np.nanmedian(distance, axis=1)
        worst = int(np.argmax(typical))
        if len(typical) <= MIN_FRAMES or typical[worst] <= worst_frame * np.median(typical):
            break
        kept[np.flatnonzero(kept)[worst]] = False
    solution, extra = without_outliers(first, rejection, tolerance=max(tolerance, SETTLING)), FIRST_EXTRA_SD_PX
    for _ in range(ROUNDS):
        before, extra = extra, _extra_sd_px(solution, frames)
        weighted = _weighted(solution.blocks[0], frames, extra)
        solution = without_outliers(adjust(solution.intrinsics, [weighted], tolerance=COARSE), rejection, tolerance=tolerance,
                                    settling=SETTLING)
        if abs(extra - before) <= SETTLED * before:
            break
    return StarSolution(solution=solution, kept=kept, extra_sd_px=extra)


def _weighted(frames: StarFrames, given: StarFrames, extra_sd_px: float) -> StarFrames:
    """Frames at their present attitudes, all stars given counting, their variance raised by the extra one."""
    return frames.weighted(given.weight / np.sqrt(1 + (given.weight * extra_sd_px) ** 2))


def _extra_sd_px(solution: Solution, given: StarFrames) -> float:
    """The extra standard deviation at which the inliers' chi-square equals the degrees of freedom; 0 if it is below already."""
    inlier = solution.blocks[0].weight > 0
    square = np.sum(solution.residual_px**2, axis=-1)[inlier]
    variance = given.weight[inlier] ** -2.0

    def excess(extra: float) -> float:
        return float(np.sum(square / (variance + extra**2))) - solution.degrees_of_freedom
    low, high = 0.0, float(np.sqrt(square.max())) + 1e-12
    while excess(high) > 0:
        high *= 2
    if excess(low) <= 0:
        return 0.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high


@dataclasses.dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Of each frame (V,), left out of the fit but for its attitude: mean square px^2 over its stars that fit, and chi-square
    with its expectation from the centroids' errors and the covariance of the lens that the other frames gave."""

    square_px2: np.ndarray
    chi2: np.ndarray
    expected: np.ndarray


def held_out(lens: Intrinsics, found: Sequence[Identification], model: str, *, rejection: Rejection,
             worst_frame: float) -> HeldOut:
    """The lens from the other folds, only attitudes on this one; infinite where a fold does not determine the lens."""
    out = HeldOut(**{f.name: np.full(len(found), np.inf) for f in dataclasses.fields(HeldOut)})
    fold_of = np.arange(len(found)) % min(FOLDS, len(found))
    for fold in np.unique(fold_of):
        unseen = np.flatnonzero(fold_of == fold)
        try:
            others = solve(lens, [f for f, i in zip(found, fold_of, strict=True) if i != fold], model, rejection=rejection,
                           worst_frame=worst_frame, tolerance=SETTLING)
            fitted = others.solution.intrinsics
            frames = StarFrames.of(fitted, [found[i] for i in unseen])
            posed = adjust(fitted, [_weighted(frames, frames, others.extra_sd_px)], lens_fixed=True, tolerance=COARSE)
            posed = without_outliers(posed, rejection, lens_fixed=True)
            information = evaluated(fitted, posed.blocks).information
        except BadInput:
            continue
        weight = posed.blocks[0].weight
        square = np.sum(posed.residual_px**2, axis=-1)
        counted = (weight > 0).sum(axis=1)
        of_lens = np.trace(covariance.classical(others.solution) @ information, axis1=1, axis2=2)
        out.square_px2[unseen] = np.where(weight > 0, square, 0).sum(axis=1) / np.maximum(counted, 1)
        out.chi2[unseen] = (square * weight**2).sum(axis=1)
        out.expected[unseen] = 2 * counted - StarFrames.pose_count + of_lens
    return out
