"""Intrinsics from checkerboard views: corners, bundle adjustment with board bow, outlier rejection, believable error bars.

1. Find the target in each view; refine its points; keep the detector's own where those are clearly smoother.
2. Choose the model by held-out error (solve on half of the views, only poses on the others); k3 and more have to lower it.
3. Adjust lens, bow and poses; drop corners beyond `outlier_sigma` robust sigma, and views that do not fit; again.
4. Ask whether the views determine the focal length at all.
5. Covariance: classical, and the recommended one, clustered by view as far as the corners of a view err together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..records import CalibrationMap, Frame, Measurement, Quantity
from . import _board_lens as board_lens
from ._board_lens import CANDIDATE_MODELS, MIN_VIEWS, MIN_VIEWS_FOR_BOW, MIN_VIEWS_FOR_HALVES
from ._bundle import covariance
from ._bundle.adjust import Solution
from ._bundle.outliers import Rejection
from ._bundle.start import TILT as TILT_ADVICE
from ._frames.ledger import Ledger
from ._lens_figures import left_out_figures, lens_quantities
from .corners import _views as corner
from .corners._target import Target, Unsettled

PROBED_VIEWS = 4
PICTURED_VIEWS = 3  # the worst, for whoever asks why they are
WORTH_ANOTHER_REFINER = 0.8  # of the roughness: less is chance
MIN_TILT_SPREAD_RAD = np.radians(5)
MAX_RELATIVE_FOCAL_SD = 0.05
COVERAGE_CELLS = (8, 6)
LEAST_DISTANCE_MM, MOST_DISTANCE_MM = 30.0, 50e3  # of a board in a room

LENS_SOURCE = "OpenCV camera model, integer pixel = pixel centre; uncertainty clustered by view (CR2) as far as needed"

@dataclass(frozen=True, kw_only=True)
class Settings:
    """board: inner corners (columns, rows). model None: chosen by held-out error among brown4, brown5, rational8.

    target: what stands before the camera, a `TARGET` of `measure/corners`. detector: one file of that folder; None: all that
    can see the target, until one sees all of it. marker_mm, dictionary: of a ChArUco board (`corners._target.Target`). window:
    half width of the refinement as a fraction of the local spacing, within what the target allows. outlier_sigma: corners
    farther off than this many robust sigma are dropped, at most the share `max_outliers` of them. worst_view: a view is
    dropped whose median residual exceeds the median view's by this factor. skew: also fit one; else the axes of the image
    stand at right angles, as they do on every sensor that is read out straight.
    """

    board: tuple[int, int] = (9, 6)
    square_mm: float = 25.0
    model: str | None = None
    target: str = "checkerboard"
    detector: str | None = None
    marker_mm: float | None = None
    dictionary: str = "DICT_4X4_50"
    window: float = 0.2
    outlier_sigma: float = 4.0
    max_outliers: float = 0.03
    worst_view: float = 4.0
    skew: bool = False


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """Intrinsics with full covariance from views of one flat checkerboard.

    Args:
        frames: views, any order. calmap: not needed here (corners are taken from raw pixels).

    Raises:
        BadInput: fewer than three views show the board, the board has another size, the views do not determine the lens.
    """
    settings = settings or Settings()
    _check(settings)
    ledger = Ledger(settings, "board views")
    names, seen, points_mm, small = _find_corners(frames, settings, ledger)
    size = ledger.first.image_size_px

    refiner, corners, corners_covariance_px2 = _choose_refiner(seen)

    model, held_out = _choose_model(corners, points_mm, size, settings)
    solution, _, kept = _robust(corners, points_mm, size, model, settings)
    for i in np.flatnonzero(~kept):
        ledger.rejected.append((names[i], f"residual more than {settings.worst_view:g} times the median view's: "
                                          "blurred, or another board"))
    names = [n for n, k in zip(names, kept, strict=True) if k]
    warnings = list(ledger.warnings)
    classical, recommended = covariance.classical(solution), covariance.recommended(solution)
    if len(solution.score) <= len(classical):
        warnings.append(f"only {len(names)} views for {len(classical)} parameters: uncertainties are themselves uncertain")
    _check_observable(solution, classical)
    warnings += _distance_warning(solution, settings)
    lens = len(solution.intrinsics.parameter_names)
    intrinsics = dataclasses.replace(solution.intrinsics, covariance=recommended[:lens, :lens])
    warnings += board_lens.refused_warning(settings.model, held_out)
    provenance = ledger.provenance()
    left_out, of_views = left_out_figures(solution, intrinsics)
    return Measurement(
        name="intrinsics", image_size_px=size, intrinsics=intrinsics,
        quantities=(*lens_quantities(intrinsics, LENS_SOURCE), *_bow_quantities(solution, recommended),
                    *_fit_quantities(solution, corners[kept], held_out.get(model), len(ledger.inputs)), left_out),
        evidence=_evidence(solution, corners[kept], small[kept]) | of_views | {
            "corners_covariance_px2": corners_covariance_px2[kept][np.isfinite(corners[kept]).all(axis=-1)],
            "uncertainty_classical": np.sqrt(np.diag(classical)),
            "held_out_rms_by_model_px": np.array([held_out.get(m, np.nan) for m in CANDIDATE_MODELS]),
            "training_rms_by_model_px": _training(corners, points_mm, size, settings, {model: solution} if held_out else {})},
        provenance=dataclasses.replace(provenance, settings={
            **provenance.settings, "model": model, "refiner": refiner, "views": tuple(Path(name).name for name in names)}),
        warnings=tuple(warnings), frames_used=len(names), frames_rejected=tuple(ledger.rejected))


def _check(settings: Settings) -> None:
    if min(settings.board) < 3:
        raise BadInput(f"a board of {settings.board[0]}x{settings.board[1]} inner corners is too small",
                       mend="use at least 3x3")
    if not settings.square_mm > 0:
        raise BadInput(f"square size {settings.square_mm} mm is not positive")


def _find_corners(frames: Iterable[Frame], settings: Settings,
                  ledger: Ledger) -> tuple[list[str], list[dict], np.ndarray, np.ndarray]:
    """Of the views that show the target: file names, points {refiner: Points}, its points (P, 3) in mm, small pictures."""
    target = Target(board=settings.board, square_mm=settings.square_mm, marker_mm=settings.marker_mm,
                    dictionary=settings.dictionary)
    able = corner.detectors(settings.target, settings.detector)
    quick, *_ = corner.detectors(settings.target, None)
    names, seen, small = [], [], []
    found, missed = [], []  # images in which it was found, and not, until they are enough to ask about another size
    for frame in frames:
        if not ledger.take(frame):
            continue
        grey, fine = corner.shade(frame)
        reason = f"no board of {settings.board[0]}x{settings.board[1]} {quick.POINT.split(',')[0]} is seen"
        try:
            points = corner.look(grey, fine, target, able, settings.window)
        except BadInput as error:
            raise BadInput(error.what, file=frame.file or None, mend=error.mend) from error
        except Unsettled as error:
            points, reason = None, str(error)
        if max(len(found), len(missed)) < PROBED_VIEWS:
            (missed if points is None else found).append(grey)
            if max(len(found), len(missed)) == PROBED_VIEWS:
                corner.check_board_size(found, missed, target, quick)
        if points is None:
            ledger.reject(frame, reason)
            continue
        names.append(frame.file or frame.name)
        seen.append(points)
        small.append(corner.thumbnail(grey))
    ledger.first  # noqa: B018  raises where there was no frame at all
    if max(len(found), len(missed)) < PROBED_VIEWS:
        corner.check_board_size(found, missed, target, quick)
    if len(names) < MIN_VIEWS:
        raise BadInput(f"{len(names)} of {len(names) + len(ledger.rejected)} frames can be used as views of a "
                       f"{settings.board[0]}x{settings.board[1]} board, {MIN_VIEWS} are the least"
                       + "".join(f"\n  {file}: {why}" for file, why in ledger.rejected),
                       mend="take ten or more sharp views of the whole board, " + TILT_ADVICE)
    return names, seen, corner.points_mm(target, quick), np.array(small)


def _choose_refiner(seen: list[dict]) -> tuple[str, np.ndarray, np.ndarray]:
    """Refiner, corners (V, P, 2) and covariance (V, P, 2, 2): the detector's own only where they are clearly less rough."""
    rough = {r: float(np.median([points[r].roughness_px for points in seen])) for r in corner.REFINERS}
    first, second = corner.REFINERS
    best = second if rough[second] < WORTH_ANOTHER_REFINER * rough[first] else first
    return best, np.array([points[best].xy_px for points in seen]), np.array([points[best].covariance_px2 for points in seen])


def _choose_model(corners: np.ndarray, points_mm: np.ndarray, size: tuple[int, int], settings: Settings) -> tuple[str, dict]:
    """Model name and {model: held-out rms in px}; the first candidate where there are too few views to ask."""
    if len(corners) < MIN_VIEWS_FOR_HALVES:
        return settings.model or CANDIDATE_MODELS[0], {}
    held_out = {model: board_lens.held_out_px2(corners, points_mm, size, model, rejection=_rejection(settings),
                                               worst_view=settings.worst_view, skew_free=settings.skew)
                for model in dict.fromkeys((*CANDIDATE_MODELS, settings.model or CANDIDATE_MODELS[0]))}
    model = settings.model or board_lens.best_model({m: held_out[m] for m in CANDIDATE_MODELS})
    return model, {m: float(np.sqrt(square.mean())) for m, square in held_out.items()}


def _training(corners: np.ndarray, points_mm: np.ndarray, size: tuple[int, int], settings: Settings,
              known: dict[str, Solution]) -> np.ndarray:
    """rms (px) over the inliers of each candidate model fitted to all views; NaN where it was not asked for or does not fit."""
    out = np.full(len(CANDIDATE_MODELS), np.nan)
    for i, model in enumerate(CANDIDATE_MODELS if known else ()):
        try:
            solution = known.get(model) or _robust(corners, points_mm, size, model, settings)[0]
        except BadInput:  # a model that folds is no candidate
            continue
        inlier = solution.blocks[0].weight > 0
        out[i] = np.sqrt(np.sum(solution.residual_px[inlier] ** 2) / inlier.sum())
    return out


def _rejection(settings: Settings) -> Rejection:
    return Rejection(sigma=settings.outlier_sigma, most=settings.max_outliers)


def _robust(corners: np.ndarray, points_mm: np.ndarray, size: tuple[int, int], model: str,
            settings: Settings) -> tuple[Solution, np.ndarray, np.ndarray]:
    """Solution, inlier corners (of the kept views) and kept views (V,)."""
    solution, kept = board_lens.solve(corners, points_mm, size, model, rejection=_rejection(settings),
                                      worst_view=settings.worst_view, skew_free=settings.skew)
    return solution, solution.blocks[0].weight > 0, kept


def _check_observable(solution: Solution, classical: np.ndarray) -> None:
    normal = solution.blocks[0].rotation[:, :, 2]
    spread = float(np.arccos(np.clip(normal @ normal.T, -1, 1)).max())
    relative = float(np.sqrt(classical[0, 0]) / solution.intrinsics.fx_px)
    if spread < MIN_TILT_SPREAD_RAD or relative > MAX_RELATIVE_FOCAL_SD:
        scale = 1 / np.sqrt(np.diag(classical))
        condition = np.linalg.cond(classical * np.outer(scale, scale))
        raise BadInput("the views do not determine the focal length: the board's tilt differs by "
                       f"{np.degrees(spread):.1f} degrees between the views, fx is known to {100 * relative:.2g} %, "
                       f"condition number {condition:.2g}",
                       mend=TILT_ADVICE)


def _distance_warning(solution: Solution, settings: Settings) -> list[str]:
    distance_mm = float(np.median(np.linalg.norm(solution.blocks[0].translation_mm, axis=1)))
    if LEAST_DISTANCE_MM < distance_mm < MOST_DISTANCE_MM:
        return []
    return [f"with squares of {settings.square_mm:g} mm the board stood {distance_mm:.3g} mm away: check --square-mm (the lens "
            "does not depend on it, the board's bow and distance do)"]


def _evidence(solution: Solution, corners: np.ndarray, small: np.ndarray) -> dict[str, np.ndarray]:
    """Observations and residuals of the corners found, view by view, and what is known of each view."""
    (boards,) = solution.blocks
    found = np.isfinite(corners).all(axis=-1)
    view, point = np.nonzero(found)
    square = np.where(found, np.sum(solution.residual_px**2, axis=-1), 0)
    rms = np.sqrt(square.sum(axis=1) / found.sum(axis=1))
    worst = np.argsort(-rms)[:PICTURED_VIEWS]
    return {"corners_xy_px": corners[found], "corners_view": view, "corners_board_mm": boards.points_mm[point],
            "residual_px": solution.residual_px[found], "inlier": boards.weight[found] > 0, "poses": boards.poses,
            "view_rms_px": rms, "worst_views": worst, "worst_views_picture": small[worst],
            "coverage_count": _coverage(corners[found], solution.intrinsics.image_size_px)}


def _coverage(xy_px: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Number of corners in each of COVERAGE_CELLS (columns, rows) cells of the image, as (rows, columns)."""
    edges = [np.linspace(-0.5, n - 0.5, cells + 1) for n, cells in zip(size, COVERAGE_CELLS, strict=True)]
    return np.histogram2d(xy_px[:, 1], xy_px[:, 0], bins=edges[::-1])[0].astype(np.int64)


def _bow_quantities(solution: Solution, recommended: np.ndarray) -> list[Quantity]:
    (boards,) = solution.blocks
    source = "height of the centre over the edges, away from the camera positive"
    if not boards.bow_free:
        return [Quantity(name=f"board_bow_{axis}_mm", unit="mm", source=source, value=None,
                         reason=f"needs at least {MIN_VIEWS_FOR_BOW} views") for axis in "xy"]
    sd = np.sqrt(np.diag(recommended)[-2:])
    return [Quantity(name=f"board_bow_{axis}_mm", unit="mm", source=source, value=float(value), uncertainty=float(error))
            for axis, value, error in zip("xy", boards.bow_mm, sd, strict=True)]


def _fit_quantities(solution: Solution, corners: np.ndarray, held_out_rms_px: float | None, views_given: int) -> list[Quantity]:
    found, inlier = np.isfinite(corners).all(axis=-1), solution.blocks[0].weight > 0
    square = np.sum(solution.residual_px**2, axis=-1)
    rms = "sqrt(mean(dx^2 + dy^2))"
    counts = {"views_given": views_given, "views_used": len(inlier), "points": int(found.sum()),
              "outliers": int((found & ~inlier).sum())}
    return [
        Quantity(name="rms_px", value=float(np.sqrt(square[inlier].mean())), unit="px", source=f"{rms} over inliers"),
        Quantity(name="rms_all_px", value=float(np.sqrt(square[found].mean())), unit="px", source=f"{rms} over every corner"),
        Quantity(name="held_out_rms_px", value=held_out_rms_px, unit="px",
                 source=f"{rms}; lens from every other view, only poses fitted to the rest",
                 reason="" if held_out_rms_px else f"needs at least {MIN_VIEWS_FOR_HALVES} views"),
        *(Quantity(name=name, value=float(value), unit="1", source="count") for name, value in counts.items())]
