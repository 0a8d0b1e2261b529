"""View: what is believed about the lens, and the spots' directions under it, with tolerances that follow from covariance.

A lens is one of
- calibrated: the map's intrinsics; directions are good to their covariance;
- guessed: a lens without distortion, or one that images angles evenly, of a focal length that may be off by `scale_slack`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..geometry import kernels, projection
from ..geometry.projection_error import direction_covariance
from ..records import Intrinsics, Spots
from .kernels import TOLERANCE_SIGMA
from .per_lens import lens_terms, per_lens

GUESSED_RATIO_ERROR = 0.012  # an uncalibrated lens bends length ratios by this much (k1 of -0.1 over 20 degrees)
# k1, k2 of what a lens may be like: no distortion, r = f tan t; or even angles, r = f t, by the arc tangent's series, as wide
# lenses do that nobody corrected.
STRAIGHT, EVEN = (0.0, 0.0), (-1 / 3, 1 / 5)
CALIBRATED_MISFIT = 3e-4  # of an angle: focus drift that a calibrated lens is allowed
DRIFTED_SCALE_SLACK = 0.002  # a lens that has drifted: its focus moves with temperature by 0.2 %,
DRIFTED_SD_PX = 0.3  # and its distortion by this
CALIBRATED_MODEL_SD_PX, GUESSED_MODEL_SD_PX = 0.03, 0.15  # what a lens model itself may be off
WIDEST_PX = 3.0  # a star farther than this from its spot is another star, however badly a map fits
GRID = (13, 9)  # nodes over the image at which a lens's errors are computed once


class Field(NamedTuple):
    """What the compiled verification asks of a view: centre (3,) and half_diagonal rad of the image; filling: part of the
    circle about the image that the image fills; slack: fraction by which angles may be off together; widest rad: largest
    circle in which a star may stand from its spot."""

    centre: np.ndarray
    half_diagonal: float
    filling: float
    slack: float
    widest: float


@dataclass(frozen=True, kw_only=True)
class View:
    """directions (N, 3) in camera axes of the spots xy_px (N, 2), brightest first; sigma_rad (N,) of one axis of each.

    scale_slack: how far, as a fraction, all angles may be off together. ratio_error: as a fraction, how far two lengths'
    ratio may be off through distortion. calibrated: the lens comes from a map and is not to be fitted.
    field: the image as it stands on the sky under this lens.
    """

    intrinsics: Intrinsics
    calibrated: bool
    scale_slack: float
    ratio_error: float
    xy_px: np.ndarray
    directions: np.ndarray
    sigma_rad: np.ndarray
    field: Field

    @property
    def half_diagonal_rad(self) -> float:
        """Angle from the image's centre to its farthest corner."""
        return self.field.half_diagonal


def _edge(size: tuple[int, int]) -> np.ndarray:
    """The image's centre and corners, (5, 2) px."""
    w, h = size
    return np.array([[(w - 1) / 2, (h - 1) / 2], [-0.5, -0.5], [w - 0.5, -0.5], [-0.5, h - 0.5], [w - 0.5, h - 0.5]])


def field_of(lens: Intrinsics, slack: float) -> Field:
    """The image on the sky."""
    w, h = lens.image_size_px
    v = projection.unproject(lens, _edge(lens.image_size_px))
    half = float(np.arccos(np.clip(v[1:] @ v[0], -1, 1).min()))
    solid_angle = w * h / (lens.fx_px * lens.fy_px) * np.cos(half / 2) ** 3  # between its centre's scale and its corners'
    return Field(centre=v[0].copy(), half_diagonal=half, filling=float(min(1, solid_angle / (2 * np.pi * (1 - np.cos(half))))),
                 slack=slack, widest=WIDEST_PX / lens.fx_px)


def field_key(view: View) -> float:
    """Half diagonal of the field, rounded up in steps of 10 %: like views share one table of stars."""
    return float(np.exp(np.ceil(np.log(view.half_diagonal_rad * (1 + view.scale_slack)) * 10) / 10))


def side_tolerance(view: View, first: np.ndarray, second: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """How far, rad, the angle between spots of rows `first` and `second` (...) may be from the catalogue's."""
    noise = np.hypot(view.sigma_rad[first], view.sigma_rad[second])
    return TOLERANCE_SIGMA * noise + (view.scale_slack + view.ratio_error) * angle_rad


@dataclass(frozen=True)
class KnownLens:
    """A map's lens made ready: everything about it that does not change from frame to frame is computed once."""

    intrinsics: Intrinsics

    @cached_property
    def errors(self) -> np.ndarray:
        """(rows, columns, 2) on a GRID over the image: (rad per px)^2, mean of the axes, and the lens's own variance, rad^2.

        The variance is that of angles: what turns all directions together is not in it.
        """
        lens = self.intrinsics
        w, h = lens.image_size_px
        xy = np.stack(np.meshgrid(np.linspace(0, w - 1, GRID[0]), np.linspace(0, h - 1, GRID[1])), -1).reshape(-1, 2)
        _, by_xy = projection.unproject_with_jacobian(lens, xy)
        known = Intrinsics(**{f: getattr(lens, f) for f in lens.__dataclass_fields__ if f != "covariance"},
                           covariance=np.nan_to_num(lens.covariance, posinf=0.0))
        own = np.trace(direction_covariance(known, xy), axis1=1, axis2=2) / 2
        return np.stack([(by_xy**2).sum((1, 2)) / 2, own], -1).reshape(*GRID[::-1], 2)

    @cached_property
    def _fields(self) -> dict[float, Field]:
        return {slack: field_of(self.intrinsics, slack) for slack in (CALIBRATED_MISFIT, DRIFTED_SCALE_SLACK)}

    def view(self, spots: Spots, *, drifted: bool = False) -> View:
        """Directions, good to centroids, the lens's covariance and its model; `drifted`: also to what time may do to a lens.

        Raises:
            BadInput: a spot lies where the lens folds.
        """
        slack, extra = (DRIFTED_SCALE_SLACK, DRIFTED_SD_PX) if drifted else (CALIBRATED_MISFIT, CALIBRATED_MODEL_SD_PX)
        v = kernels.unproject(*lens_terms(self.intrinsics), spots.xy_px)
        if np.isnan(v).any():
            projection.unproject(self.intrinsics, spots.xy_px)  # says which pixel, and why
        sigma = kernels.direction_sigma(self.errors, *self.intrinsics.image_size_px, spots.xy_px, spots.covariance_px2, extra)
        return View(intrinsics=self.intrinsics, calibrated=True, scale_slack=slack, ratio_error=0.0, xy_px=spots.xy_px,
                    directions=v, sigma_rad=sigma, field=self._fields[slack])


def guessed_view(spots: Spots, lens: Intrinsics, scale_slack: float) -> View:
    """Directions through a lens that may be like this one, but for its focal length, to scale_slack, and some distortion."""
    sigma = np.sqrt(np.trace(spots.covariance_px2, axis1=1, axis2=2) / 2) / lens.fx_px
    return View(intrinsics=lens, calibrated=False, scale_slack=scale_slack, ratio_error=GUESSED_RATIO_ERROR, xy_px=spots.xy_px,
                directions=projection.unproject(lens, spots.xy_px), sigma_rad=sigma, field=field_of(lens, scale_slack))


def guessed_lens(fov_rad: float, image_size_px: tuple[int, int], shape: tuple[float, float]) -> Intrinsics:
    """A lens of this shape with this horizontal field (outer edges of the first and last column), centred on the image."""
    w, h = image_size_px
    edge, (k1, k2) = np.tan(fov_rad / 2), shape
    focal = w / 2 / (edge * (1 + k1 * edge**2 + k2 * edge**4))
    return Intrinsics(model="brown4", fx_px=focal, fy_px=focal, cx_px=(w - 1) / 2, cy_px=(h - 1) / 2,
                      distortion=np.array([k1, k2, 0, 0]), image_size_px=image_size_px, covariance=np.full((8, 8), np.inf))


@per_lens
def horizontal_fov(intrinsics: Intrinsics) -> float:
    """Angle, rad, between the outer edges of the first and last column at mid height, distortion included."""
    w, h = intrinsics.image_size_px
    left, right = projection.unproject(intrinsics, np.array([[-0.5, (h - 1) / 2], [w - 0.5, (h - 1) / 2]]))
    return float(np.arctan2(np.linalg.norm(np.cross(left, right)), left @ right))
