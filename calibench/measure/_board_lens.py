"""Lens from the corners of one board: adjustment without what does not fit, and the choice of the model by held-out error."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..errors import BadInput
from ..records import DISTORTION_NAMES, Intrinsics
from ._bundle.adjust import COARSE, Solution, adjust
from ._bundle.outliers import Rejection, without_outliers
from ._bundle.start import NO_FOCAL, TILT, posed, start

MIN_VIEWS = 3
MIN_VIEWS_FOR_BOW = 5
MIN_VIEWS_FOR_HALVES = 6
CANDIDATE_MODELS = ("brown4", "brown5", "rational8")
WORTH_A_TERM = 0.99  # each further term has to lower the held-out rms by 1 %: less is chance, and it bends the corners
CHANCE_SIGMA = 2.0
SUSPECT_PX = 0.5  # a typical residual that no corners of one camera leave


def solve(corners_px: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str, *,
          rejection: Rejection, worst_view: float, skew_free: bool = False) -> tuple[Solution, np.ndarray]:
    """Lens, bow and poses without outlying corners and views.

    Args:
        corners_px: (V, P, 2), NaN where a corner was not found. worst_view: a view is dropped whose median residual exceeds
            the median view's by this factor. skew_free: the lens has a skew.

    Returns:
        Solution over the kept views, and which (V,) those are.

    Raises:
        BadInput: the views do not determine the lens.
    """
    kept = np.ones(len(corners_px), bool)
    while True:
        try:
            first = _coarse(corners_px[kept], points_mm, image_size_px, model, skew_free)
        except BadInput:
            kept[_spoiling(corners_px, kept, points_mm, image_size_px, model, skew_free)[0]] = False
            continue
        (block,) = first.blocks
        distance = np.where(block.weight > 0, np.linalg.norm(first.residual_px, axis=-1), np.nan)
        typical = np.nanmedian(distance, axis=1)  # one wild corner is no wild view
        worst = int(np.argmax(typical))
        if len(typical) > MIN_VIEWS and typical[worst] <= worst_view * np.median(typical) and np.median(typical) > SUSPECT_PX:
            spoiling, others = _spoiling(corners_px, kept, points_mm, image_size_px, model, skew_free)
            if others < np.median(typical) / worst_view:  # it bent the lens so much that all views fit badly
                kept[spoiling] = False
                continue
        if len(typical) <= MIN_VIEWS or typical[worst] <= worst_view * np.median(typical):
            return without_outliers(first, rejection), kept
        kept[np.flatnonzero(kept)[worst]] = False


def _spoiling(corners_px: np.ndarray, kept: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str,
              skew_free: bool) -> tuple[int, float]:
    """The view without which the others agree best, and their median residual, px: one of another camera can spoil all.

    Raises:
        BadInput: without any one view the others do not determine the lens either.
    """
    misses, refused = {}, None
    for view in np.flatnonzero(kept) if kept.sum() > MIN_VIEWS else ():
        others = kept & (np.arange(len(kept)) != view)
        try:
            solution = _coarse(corners_px[others], points_mm, image_size_px, model, skew_free)
        except BadInput as error:
            refused = error
            continue
        (block,) = solution.blocks
        misses[int(view)] = float(np.median(np.linalg.norm(solution.residual_px, axis=-1)[block.weight > 0]))
    if not misses:
        raise refused or BadInput(NO_FOCAL, mend=TILT)
    best = min(misses, key=misses.get)
    return best, misses[best]


def _coarse(corners_px: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str,
            skew_free: bool) -> Solution:
    """A first solution; a model of many terms starts from the one of few, where all are well determined.

    In a wide image the model of few terms fits best where it folds, and the way to the one of many leads through there; in
    a narrow one that way may end in a fold, and the one without folds is taken.
    """
    few = "brown4" if len(DISTORTION_NAMES[model]) > 5 else model
    lens, boards = start(corners_px, points_mm, image_size_px, few, skew_free=skew_free)
    boards = dataclasses.replace(boards, bow_free=len(corners_px) >= MIN_VIEWS_FOR_BOW)
    for past_fold in (True, False):
        solution = adjust(lens, [boards], tolerance=COARSE, past_fold=past_fold)
        if few != model:
            solution = adjust(with_model(solution.intrinsics, model), solution.blocks, tolerance=COARSE, past_fold=past_fold)
        if not solution.folds:
            break
    return solution


def with_model(lens: Intrinsics, model: str) -> Intrinsics:
    """The same lens under a model with more (or fewer) terms; covariance unknown. Terms of another family begin at zero."""
    terms = len(DISTORTION_NAMES[model])
    unknown = np.full((4 + terms + (lens.skew_px is not None),) * 2, np.inf)
    same = dataclasses.replace(lens, model=model, distortion=np.zeros(terms), covariance=unknown)
    if same.is_fisheye != lens.is_fisheye:
        return same
    return dataclasses.replace(same, distortion=np.resize(np.append(lens.distortion, np.zeros(terms)), terms))


def held_out_px2(corners_px: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str, *,
                 rejection: Rejection, worst_view: float, skew_free: bool = False) -> np.ndarray:
    """Mean square residual (V,) of each view over its inliers, when only its pose is fitted, to a lens from the other half.

    The halves are the even and the odd views. Infinite where a half does not determine the lens, or its lens has no
    direction for a corner of the other half.
    """
    out = np.empty(len(corners_px))
    for first in (0, 1):
        try:
            lens, _ = solve(corners_px[first::2], points_mm, image_size_px, model, rejection=rejection, worst_view=worst_view,
                            skew_free=skew_free)
            boards = posed(lens.intrinsics, corners_px[1 - first::2], points_mm, bow_mm=lens.blocks[0].bow_mm)
            unseen = without_outliers(adjust(lens.intrinsics, [boards], lens_fixed=True, tolerance=COARSE), rejection,
                                      lens_fixed=True)
        except BadInput:
            return np.full(len(corners_px), np.inf)
        inlier = unseen.blocks[0].weight > 0
        square = np.where(inlier, np.sum(unseen.residual_px**2, axis=-1), 0)
        out[1 - first::2] = square.sum(axis=1) / np.maximum(inlier.sum(axis=1), 1)
    return out


def best_model(held_out_px2: dict[str, np.ndarray]) -> str:
    """The model with the fewest terms that no other beats by more than chance.

    Args:
        held_out_px2: mean square of each view (V,) by model, fewest terms first. More terms have to lower the rms, by 1 % a
            term, and to do so in enough of the views: by two standard errors of the difference.
    """
    best, *more = held_out_px2
    for model in more:
        old, new = held_out_px2[best], held_out_px2[model]
        if not np.isfinite(new).all():
            continue
        further = len(DISTORTION_NAMES[model]) - len(DISTORTION_NAMES[best])
        gain = old - new  # infinite where the old one was not determined
        if new.mean() < WORTH_A_TERM ** (2 * further) * old.mean() and (
                not np.isfinite(old).all() or gain.mean() > CHANCE_SIGMA * gain.std() / np.sqrt(len(gain))):
            best = model
    return best


def refused_warning(asked: str | None, held_out_rms_px: dict[str, float]) -> tuple[str, ...]:
    """What to say of a model that was asked for although its held-out error is larger than another's."""
    if asked is None or WORTH_A_TERM * held_out_rms_px.get(asked, 0.0) <= min(held_out_rms_px.values(), default=0.0):
        return ()
    return (f"{asked} was asked for, but raises the held-out error: " +
            ", ".join(f"{model} {error:.4f} px" for model, error in held_out_rms_px.items()),)
