"""From a frame to refined points by the detectors of one kind of target; and the question whether the board's size is right."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

import cv2
import numpy as np

from ... import registry
from ...errors import BadInput, UsageError
from ...records import Frame
from ._symmetry import refine, roughness_px
from ._target import Target, Unsettled

FOLDER = "calibench.measure.corners"
REFINERS = ("symmetry", "detector")  # the second: sub-pixel places as the detector itself gives them
LEAST_POINTS = 9
THUMBNAIL_PX = 320
DEMOSAIC = {"RGGB": cv2.COLOR_BayerRGGB2GRAY, "BGGR": cv2.COLOR_BayerBGGR2GRAY,
            "GRBG": cv2.COLOR_BayerGRBG2GRAY, "GBRG": cv2.COLOR_BayerGBRG2GRAY}


@dataclass(frozen=True, kw_only=True)
class Points:
    """One way to the points of a view: xy_px (P, 2) and covariance_px2 (P, 2, 2), NaN: not seen; roughness_px: their median
    distance from a smooth map of the board."""

    xy_px: np.ndarray
    covariance_px2: np.ndarray
    roughness_px: float


def detectors(target: str, detector: str | None) -> list[ModuleType]:
    """The detector asked for, or all of a kind of target, the one that bears its name first.

    Raises:
        UsageError: no such target or detector, or the detector is for another target.
    """
    modules = {name: registry.load(FOLDER, name) for name in registry.names(FOLDER)}
    kinds = sorted({module.TARGET for module in modules.values()})
    if target not in kinds:
        raise UsageError(f"no target '{target}'", mend=f"choose one of: {', '.join(kinds)}")
    able = sorted((n for n, module in modules.items() if module.TARGET == target), key=lambda n: (n != target, n))
    if detector is not None and registry.load(FOLDER, detector).TARGET != target:
        raise UsageError(f"the detector {detector} is not for the target {target}", mend=f"choose one of: {', '.join(able)}")
    return [modules[name] for name in ([detector] if detector else able)]


def shade(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) uint8 for the detectors, to which deeper data are stretched, and the data of full depth for the refiner."""
    data = np.ascontiguousarray(frame.data)
    if frame.bayer_pattern:
        data = cv2.cvtColor(data, DEMOSAIC[frame.bayer_pattern])
    if data.dtype == np.uint8:
        return data, data
    low, high = np.percentile(data[::4, ::4], (0.1, 99.9))
    return np.clip((data - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8), data


def thumbnail(grey: np.ndarray) -> np.ndarray:
    """A small picture (h, w) uint8 of a view."""
    height, width = grey.shape
    by = max(1.0, max(height, width) / THUMBNAIL_PX)
    return cv2.resize(grey, (round(width / by), round(height / by)), interpolation=cv2.INTER_AREA)


def look(grey: np.ndarray, fine: np.ndarray, target: Target, able: Sequence[ModuleType],
         window: float) -> dict[str, Points] | None:
    """The target by each of REFINERS, from the first detector that sees all of it, or else the one that sees most.

    Args:
        grey, fine: from `shade`. window: half width of the refinement as a fraction of the local spacing, kept within what the
            detector's target allows.

    Returns:
        None where no detector sees the target.

    Raises:
        Unsettled: a part of it is seen, and none can tell which.
    """
    best, unsettled = None, None
    for module in able:
        try:
            rough = module.find(grey, target)
        except Unsettled as error:
            unsettled = error
            continue
        if rough is None:
            continue
        seen = _refined(fine, rough, module, target, window)
        if seen and (best is None or _count(seen) > _count(best)):
            best = seen
        if np.isfinite(rough).all() and seen:
            break
    if best is None and unsettled:
        raise unsettled
    return best


def _refined(fine: np.ndarray, rough: np.ndarray, module: ModuleType, target: Target,
             window: float) -> dict[str, Points] | None:
    """The points by each of REFINERS; None where too few remain."""
    uv = module.points(target.board)
    nearest = np.linalg.norm(uv[1:] - uv[0], axis=1).min()
    xy, covariance = refine(fine, rough, uv / nearest, float(np.clip(window, *module.WINDOWS)))
    if np.isfinite(xy[:, 0]).sum() < LEAST_POINTS:
        return None
    own = roughness_px(rough, uv)
    as_found = np.where(np.isfinite(rough)[..., None], np.eye(2) * own**2, np.nan)
    return {"symmetry": Points(xy_px=xy, covariance_px2=covariance, roughness_px=roughness_px(xy, uv)),
            "detector": Points(xy_px=rough, covariance_px2=as_found, roughness_px=own)}


def _count(seen: dict[str, Points]) -> int:
    return int(np.isfinite(seen["symmetry"].xy_px[:, 0]).sum())


def points_mm(target: Target, module: ModuleType) -> np.ndarray:
    """(P, 3) places of the points on a flat board, row by row, mm."""
    return np.pad(module.points(target.board), ((0, 0), (0, 1))) * target.square_mm


def check_board_size(found: Sequence[np.ndarray], missed: Sequence[np.ndarray], target: Target, module: ModuleType) -> None:
    """Ask whether the views show a target of another size: a larger one, or where most do not show the one said, any other.

    Args:
        found, missed: some views (H, W) uint8 in which the target was found, whole or in part, and some in which it was not.

    Raises:
        BadInput: most of these views show one other size.
    """
    sizes = [size for grey in (*found, *missed) if (size := module.shown(grey, target))]
    if not sizes:
        return
    size, views = Counter(sizes).most_common(1)[0]
    larger = any(is_ > said for is_, said in zip(size, target.board, strict=True))
    if size != target.board and 2 * views > len(found) + len(missed) and (larger or len(missed) > len(found)):
        raise BadInput("found {}x{}, you said {}x{}: count {}".format(*size, *target.board, module.POINT),
                       mend="give --board {}x{}".format(*size))
