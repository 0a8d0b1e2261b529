"""Projection: directions in camera axes <-> raw (distorted) pixels, with Jacobians.

A lens model bends a direction (X, Y, Z) into x', y' (`_rational`, `_fisheye`: one file a family, told apart here), and then
    column = fx x' + skew y' + cx, row = fy y' + cy          (a mirrored camera flips X first)

Beyond the angle where x' turns back (the lens model folds) two directions would share a pixel: there nothing is visible.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np

from ..errors import BadInput
from ..records import Intrinsics
from . import _fisheye, _rational


def _family(intrinsics: Intrinsics) -> ModuleType:
    return _fisheye if intrinsics.is_fisheye else _rational


def fold_radius(intrinsics: Intrinsics) -> float:
    """Normalised radius tan(theta) up to which the radial distortion is monotone; infinite where it never folds."""
    return _family(intrinsics).fold_radius(tuple(intrinsics.distortion.tolist()))


def fold_angle(intrinsics: Intrinsics) -> float:
    """Angle from the axis, rad, up to which the lens does not fold (pi at most, for a fisheye)."""
    if intrinsics.is_fisheye:
        return _fisheye.fold_angle(tuple(intrinsics.distortion.tolist()))
    return float(np.arctan(fold_radius(intrinsics)))


def bend(intrinsics: Intrinsics, x: np.ndarray, y: np.ndarray, z: np.ndarray, *, jacobian: bool,
         past_fold: bool = False) -> tuple:
    """Components X, Y, Z of directions, arrays of any one shape, into image coordinates in units of the focal length.

    The form for many points: nothing is stacked. Callers that want points as rows use `project`. past_fold: the formula also
    where the lens folds; an adjustment passes through such lenses on its way.

    Returns:
        (x', y'); with `jacobian` their derivatives by X, Y, Z as two triples, and by the distortion terms as a list of
        pairs (else None and an empty list). NaN where not visible.
    """
    out, by_v, by_terms = _family(intrinsics).bend(intrinsics.distortion, -x if intrinsics.mirrored else x, y, z,
                                                   jacobian=jacobian, past_fold=past_fold)
    if by_v and intrinsics.mirrored:
        by_v = tuple((-by_x, by_y, by_z) for by_x, by_y, by_z in by_v)
    return out, by_v, by_terms


def project(intrinsics: Intrinsics, v_cam: np.ndarray) -> np.ndarray:
    """Directions (N, 3) in camera axes -> (N, 2) raw pixels; NaN where not visible: behind the camera, beyond the fold."""
    (xd, yd), _, _ = bend(intrinsics, *np.asarray(v_cam, float).T, jacobian=False)
    return np.stack([xd, yd], -1) @ _focal(intrinsics).T + (intrinsics.cx_px, intrinsics.cy_px)


def _focal(intrinsics: Intrinsics) -> np.ndarray:
    """(2, 2) pixels by x', y'."""
    return intrinsics.camera_matrix[:2, :2]


def project_with_jacobian(intrinsics: Intrinsics, v_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `project`, with derivatives.

    Returns:
        xy_px (N, 2), d_xy_d_v (N, 2, 3), d_xy_d_parameters (N, 2, P) in the order of `intrinsics.parameter_names`.
    """
    (xd, yd), by_v, by_terms = bend(intrinsics, *np.asarray(v_cam, float).T, jacobian=True)
    focal = _focal(intrinsics)
    xy = np.stack([xd, yd], -1) @ focal.T + (intrinsics.cx_px, intrinsics.cy_px)
    o, one = np.zeros_like(xd), np.ones_like(xd)
    camera = [np.stack(pair, -1) for pair in ((xd, o), (o, yd), (one, o), (o, one))]
    terms = [np.stack(pair, -1) @ focal.T for pair in by_terms]
    skew = [] if intrinsics.skew_px is None else [np.stack((yd, o), -1)]
    return xy, focal @ np.stack([np.stack(row, -1) for row in by_v], -2), np.stack(camera + terms + skew, -1)


def unproject(intrinsics: Intrinsics, xy_px: np.ndarray) -> np.ndarray:
    """Raw pixels (N, 2) -> unit vectors (N, 3) in camera axes.

    Raises:
        BadInput: a pixel lies where the lens model folds and has no direction.
    """
    xy = np.asarray(xy_px, float)
    yd = (xy[:, 1] - intrinsics.cy_px) / intrinsics.fy_px
    xd = (xy[:, 0] - intrinsics.cx_px - (intrinsics.skew_px or 0.0) * yd) / intrinsics.fx_px
    v, bad = _family(intrinsics).straighten(intrinsics.distortion, xd, yd)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise BadInput(f"the lens model ({intrinsics.model}) cannot be inverted at pixel ({xy[i, 0]:.1f}, {xy[i, 1]:.1f}): "
                       f"it folds at radius {fold_radius(intrinsics):.3f}",
                       mend="calibrate with views that reach the corners, or with fewer distortion terms")
    if intrinsics.mirrored:
        v[:, 0] *= -1
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def unproject_with_jacobian(intrinsics: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `unproject`, with d_v_d_xy (N, 3, 2), rad per px."""
    v = unproject(intrinsics, xy_px)
    _, by_v, _ = bend(intrinsics, *v.T, jacobian=True)
    forward = _focal(intrinsics) @ np.stack([np.stack(row, -1) for row in by_v], -2)
    back = np.swapaxes(forward, 1, 2)  # (N, 2, 3) with forward @ v = 0: its pseudo-inverse stays in the tangent plane
    return v, back @ np.linalg.inv(forward @ back)
