"""View: what is believed about the lens, and the spots' directions under it, with tolerances that follow from covariance.

A lens is one of
- calibrated: the map's intrinsics; directions are good to their covariance;
- guessed: an ideal lens of a focal length that may be off by `scale_slack`, with an unknown distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry import projection
from ..records import Intrinsics, Spots

TOLERANCE_SIGMA = 4.0
GUESSED_RATIO_ERROR = 0.012  # an uncalibrated lens bends length ratios by this much (k1 of -0.1 over 20 degrees)
CALIBRATED_SCALE_SLACK = 0.002  # focus moves with temperature: 0.2 %


@dataclass(frozen=True, kw_only=True)
class View:
    """directions (N, 3) in camera axes of the spots xy_px (N, 2), brightest first; sigma_rad (N,) of one axis of each.

    scale_slack: how far, as a fraction, all angles may be off together. ratio_error: as a fraction, how far two lengths'
    ratio may be off through distortion. calibrated: the lens comes from a map and is not to be fitted.
    """

    intrinsics: Intrinsics
    calibrated: bool
    scale_slack: float
    ratio_error: float
    xy_px: np.ndarray
    directions: np.ndarray
    sigma_rad: np.ndarray

    @cached_property
    def half_diagonal_rad(self) -> float:
        """Angle from the image's centre to its farthest corner."""
        w, h = self.intrinsics.image_size_px
        corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [-0.5, h - 0.5], [w - 0.5, h - 0.5]])
        corner_v = projection.unproject(self.intrinsics, corners)
        return float(np.arccos(np.clip(corner_v @ self.centre, -1, 1).min()))

    @cached_property
    def centre(self) -> np.ndarray:
        """Direction (3,) of the image's centre ((W-1)/2, (H-1)/2)."""
        w, h = self.intrinsics.image_size_px
        return projection.unproject(self.intrinsics, np.array([[(w - 1) / 2, (h - 1) / 2]]))[0]


def field_key(view: View) -> float:
    """Half diagonal of the field, rounded up in steps of 10 %: like views share one table of stars."""
    return float(np.exp(np.ceil(np.log(view.half_diagonal_rad * (1 + view.scale_slack)) * 10) / 10))


def calibrated_view(spots: Spots, intrinsics: Intrinsics) -> View:
    """Directions through a measured lens; sigma from centroid and intrinsics covariance (common shift left in: safe side)."""
    v, by_xy = projection.unproject_with_jacobian(intrinsics, spots.xy_px)
    _, by_v, by_p = projection.project_with_jacobian(intrinsics, v)
    covariance = spots.covariance_px2 + by_p @ np.nan_to_num(intrinsics.covariance, posinf=0.0) @ np.swapaxes(by_p, 1, 2)
    v_covariance = by_xy @ covariance @ np.swapaxes(by_xy, 1, 2)
    sigma = np.sqrt(np.trace(v_covariance, axis1=1, axis2=2) / 2)
    return View(intrinsics=intrinsics, calibrated=True, scale_slack=CALIBRATED_SCALE_SLACK, ratio_error=0.0, xy_px=spots.xy_px,
                directions=v, sigma_rad=sigma)


def guessed_view(spots: Spots, image_size_px: tuple[int, int], focal_px: float, scale_slack: float) -> View:
    """Directions through an ideal lens of about this focal length."""
    lens = Intrinsics.pinhole(focal_px=focal_px, image_size_px=image_size_px, focal_sd_px=focal_px * scale_slack)
    sigma = np.sqrt(np.trace(spots.covariance_px2, axis1=1, axis2=2) / 2) / focal_px
    return View(intrinsics=lens, calibrated=False, scale_slack=scale_slack, ratio_error=GUESSED_RATIO_ERROR, xy_px=spots.xy_px,
                directions=projection.unproject(lens, spots.xy_px), sigma_rad=sigma)


def focal_from_fov(fov_rad: float, image_size_px: tuple[int, int]) -> float:
    """Focal length, px, of an ideal lens with this horizontal field (outer edges of the first and last column)."""
    return image_size_px[0] / 2 / np.tan(fov_rad / 2)


def horizontal_fov(intrinsics: Intrinsics) -> float:
    """Angle, rad, between the outer edges of the first and last column at mid height, distortion included."""
    w, h = intrinsics.image_size_px
    left, right = projection.unproject(intrinsics, np.array([[-0.5, (h - 1) / 2], [w - 0.5, (h - 1) / 2]]))
    return float(np.arctan2(np.linalg.norm(np.cross(left, right)), left @ right))
