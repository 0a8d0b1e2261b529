"""Intrinsics from identified stars of many frames: the sky as a target, one attitude a frame.

1. Take the frames that were solved; start from the lens under which the richest of them was identified.
2. Choose the model by held-out frames (lens from the other frames, only an attitude on this one).
3. Adjust lens and attitudes; drop stars and frames that do not fit; find the error beyond the centroids' own.
4. Covariance: classical, and the recommended one, clustered by frame as far as the stars of a frame err together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..geometry.rotation import quaternion_from_matrix
from ..records import CalibrationMap, Identification, Intrinsics, Measurement, Provenance, Quantity
from ._board_lens import best_model, refused_warning
from ._bundle import covariance
from ._bundle.outliers import Rejection
from ._lens_figures import left_out_figures, lens_quantities
from ._star_solve import MIN_FRAMES, HeldOut, StarSolution, held_out, solve

MIN_STARS = 4  # of a frame: three more coordinates than its attitude takes
MIN_FRAMES_TO_HOLD_OUT = 4
CANDIDATE_MODELS = ("pinhole", "brown4", "brown5", "rational8")
FEWEST_TERMS = 2  # candidates that are kept where nothing can be held out
LENS_SOURCE = "OpenCV camera model, integer pixel = pixel centre, from stars; uncertainty clustered by frame as far as needed"
RMS = "sqrt(mean(dx^2 + dy^2))"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """model None: chosen by held-out error among CANDIDATE_MODELS.

    outlier_sigma: stars farther off than this many robust sigma are dropped, at most the share `max_outliers` of them.
    worst_frame: a frame is dropped whose median residual exceeds the median frame's by this factor.
    """

    model: str | None = None
    outlier_sigma: float = 4.0
    max_outliers: float = 0.1
    worst_frame: float = 4.0


def measure(frames: Iterable[Identification], settings: Settings | None = None,
            calmap: CalibrationMap | None = None) -> Measurement:
    """Intrinsics with full covariance from stars.

    Args:
        frames: identifications of one camera's frames, any order; those without a solution are left out. Their `file` names
            them in messages. calmap: not needed here (spots are raw pixels; stars bring their directions).

    Raises:
        BadInput: fewer than two solved frames, frames of different cameras, or the stars do not determine the lens.
    """
    settings = settings or Settings()
    given = list(frames)
    names = [f.file or f"frame {i}" for i, f in enumerate(given, start=1)]
    rejected = [(name, f.reason or f"{len(f.xy_px)} stars, {MIN_STARS} are the least")
                for name, f in zip(names, given, strict=True) if not _usable(f)]
    names = [name for name, f in zip(names, given, strict=True) if _usable(f)]
    found = [f for f in given if _usable(f)]
    first = _first_lens(found)

    rules = {"rejection": Rejection(sigma=settings.outlier_sigma, most=settings.max_outliers),
             "worst_frame": settings.worst_frame}
    model, held = _choose_model(first, found, settings, rules)
    solved = solve(first, found, model, **rules)
    rejected += [(name, f"residual more than {settings.worst_frame:g} times the median frame's: other stars, or trailed")
                 for name, keep in zip(names, solved.kept, strict=True) if not keep]
    classical, recommended = covariance.classical(solved.solution), covariance.recommended(solved.solution)
    intrinsics = dataclasses.replace(solved.solution.intrinsics, covariance=recommended)
    names = [name for name, keep in zip(names, solved.kept, strict=True) if keep]
    left_out, of_views = left_out_figures(solved.solution, intrinsics)
    return Measurement(
        name="star_lens", image_size_px=first.image_size_px, intrinsics=intrinsics,
        quantities=(*lens_quantities(intrinsics, LENS_SOURCE), *_fit_quantities(solved, held.get(model), len(given)),
                    left_out),
        evidence=_evidence(solved) | of_views | {
            "uncertainty_classical": np.sqrt(np.diag(classical)),
            "held_out_rms_by_model_px": np.array([_rms(held[m].square_px2) if held else np.nan for m in CANDIDATE_MODELS])},
        provenance=Provenance(settings={**dataclasses.asdict(settings), "model": model, "views": tuple(names)}),
        warnings=_warnings(intrinsics, held, settings), frames_used=len(names), frames_rejected=tuple(rejected))


def _usable(found: Identification) -> bool:
    return found.status == "solved" and found.intrinsics is not None and len(found.xy_px) >= MIN_STARS


def _first_lens(found: Sequence[Identification]) -> Intrinsics:
    """The lens of the frame with most stars."""
    if len(found) < MIN_FRAMES:
        raise BadInput(f"{len(found)} frames with at least {MIN_STARS} identified stars, {MIN_FRAMES} are the least",
                       mend="take ten or more frames of different fields")
    kinds = {(f.intrinsics.image_size_px, f.intrinsics.mirrored) for f in found}
    if len(kinds) > 1:
        raise BadInput("the frames differ in size or handedness: " + ", ".join(
            f"{w}x{h}{' mirrored' if mirrored else ''}" for (w, h), mirrored in sorted(kinds)),
                       mend="give frames of one camera at a time")
    return max(found, key=lambda f: len(f.xy_px)).intrinsics


def _choose_model(first: Intrinsics, found: Sequence[Identification], settings: Settings,
                  rules: dict) -> tuple[str, dict[str, HeldOut]]:
    if len(found) < MIN_FRAMES_TO_HOLD_OUT:
        return settings.model or CANDIDATE_MODELS[FEWEST_TERMS - 1], {}
    held = {model: held_out(first, found, model, **rules)
            for model in dict.fromkeys((*CANDIDATE_MODELS, settings.model or CANDIDATE_MODELS[0]))}
    return settings.model or best_model({m: held[m].square_px2 for m in CANDIDATE_MODELS}), held


def _rms(square_px2: np.ndarray) -> float:
    return float(np.sqrt(square_px2.mean()))


def _fit_quantities(solved: StarSolution, held: HeldOut | None, views_given: int) -> list[Quantity]:
    there, inlier = _there(solved), solved.frames.weight > 0
    square = np.sum(solved.solution.residual_px**2, axis=-1)
    reason = "" if held else f"needs at least {MIN_FRAMES_TO_HOLD_OUT} frames"
    if held and not np.isfinite(held.chi2).all():
        held, reason = None, "some of the frames do not determine this model"
    counts = {"views_given": views_given, "views_used": len(inlier), "points": int(there.sum()),
              "outliers": int((there & ~inlier).sum())}
    return [
        Quantity(name="rms_px", value=float(np.sqrt(square[inlier].mean())), unit="px", source=f"{RMS} over inliers"),
        Quantity(name="rms_all_px", value=float(np.sqrt(square[there].mean())), unit="px", source=f"{RMS} over every star"),
        Quantity(name="extra_sd_px", value=solved.extra_sd_px, unit="px",
                 source="error of one coordinate that the centroids' covariance does not explain, from chi-square"),
        Quantity(name="held_out_rms_px", value=_rms(held.square_px2) if held else None, unit="px", reason=reason,
                 source=f"{RMS}; lens from the other frames, only an attitude fitted"),
        Quantity(name="held_out_over_predicted", value=float(np.sqrt(held.chi2.sum() / held.expected.sum())) if held else None,
                 unit="1", reason=reason, source="held-out residual over what the covariances of centroids and lens predict"),
        *(Quantity(name=name, value=float(value), unit="1", source="count") for name, value in counts.items())]


def _there(solved: StarSolution) -> np.ndarray:
    """(V, P) rows that are stars and not padding: a frame's padding repeats its first star."""
    directions = solved.frames.direction_icrs
    there = (directions != directions[:, :1]).any(axis=-1)
    there[:, 0] = True
    return there


def _evidence(solved: StarSolution) -> dict[str, np.ndarray]:
    frames, there = solved.frames, _there(solved)
    square = np.where(there, np.sum(solved.solution.residual_px**2, axis=-1), 0)
    return {"stars_xy_px": frames.xy_px[there], "stars_view": np.nonzero(there)[0],
            "stars_direction_icrs": frames.direction_icrs[there], "residual_px": solved.solution.residual_px[there],
            "inlier": frames.weight[there] > 0, "attitudes_q_cam_icrs": np.array([quaternion_from_matrix(r)
                                                                                 for r in frames.rotation]),
            "view_rms_px": np.sqrt(square.sum(axis=1) / there.sum(axis=1))}


def _warnings(intrinsics: Intrinsics, held: dict[str, HeldOut], settings: Settings) -> tuple[str, ...]:
    out = []
    centre_sd = float(np.sqrt(np.diag(intrinsics.covariance)[2:4].max()))
    if centre_sd > 0.01 * max(intrinsics.image_size_px):
        out.append(f"the principal point is known to {centre_sd:.1f} px only: in so narrow a field a shift of it looks like a "
                   "turn of the camera; directions are as good as the projection uncertainty says")
    return tuple(out) + refused_warning(settings.model, {m: _rms(h.square_px2) for m, h in held.items()})
