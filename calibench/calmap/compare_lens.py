"""The difference of two lenses over the field, with the best rotation removed.

A star camera measures its attitude through its lens: a lens that differs from another by a rotation alone gives the same
stars another attitude and nothing else, and a board calibration cannot tell its camera's axes from its board's poses.
So, as mrcal's projection diff does, directions are compared after the rotation that brings them closest:

1. a grid of pixels q over the image; each has a direction v_a through lens A
2. rotation r (3 numbers): minimise sum |project_B(R(r) v_a) - q|^2 over the pixels of the fit region, by Gauss-Newton
3. shift = project_B(R v_a) - q in pixels; the angle between R v_a and what lens B sees in q
4. what the two covariances let expect of the shift: to first order it is P (J_b e_b - J_a e_a), where e are the errors of the
   parameters, J the projections' derivatives by them, and P takes out what the rotation of step 2 absorbs
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..geometry import projection, rotation, sphere
from ..records import Intrinsics

GRID_COLUMNS = 30
STEPS = 30
CONVERGED_RAD = 1e-11


@dataclass(frozen=True, kw_only=True)
class LensDifference:
    """Lens B against lens A on a grid of N pixels.

    shift_px (N, 2): where B puts what A sees in xy_px (N, 2), minus xy_px. angle_rad (N,): the same as angle in the sky.
    expected_px (N,): 1 sigma of |shift_px| from both covariances, independent of each other; infinite where unknown.
    rotation_rad (3,): the rotation vector removed, in camera axes. inside (N,) bool: the pixels that it was fitted to.
    """

    xy_px: np.ndarray
    shift_px: np.ndarray
    angle_rad: np.ndarray
    expected_px: np.ndarray
    rotation_rad: np.ndarray
    inside: np.ndarray

    @property
    def rms_px(self) -> float:
        """sqrt(mean(dx^2 + dy^2)) over the whole grid."""
        return float(np.sqrt(np.mean(np.sum(self.shift_px**2, axis=1))))

    @property
    def rms_rad(self) -> float:
        return float(np.sqrt(np.mean(self.angle_rad**2)))

    @property
    def expected_rms_px(self) -> float:
        return float(np.sqrt(np.mean(self.expected_px**2)))


def lens_difference(a: Intrinsics, b: Intrinsics, fit_radius_px: float | None = None) -> LensDifference:
    """Compare two lenses of one image size, also of different models.

    fit_radius_px: fit the rotation within this distance of the image's centre; None: over the whole image.

    Raises:
        BadInput: sizes or mirroring differ, a lens has no direction for some pixel of the image, the region holds fewer
            than three pixels of the grid, or the lenses are so different that no rotation brings them together.
    """
    if a.image_size_px != b.image_size_px:
        raise BadInput(f"lenses for images of {_size(a)} and {_size(b)} px cannot be compared",
                       mend="compare calibrations of the same camera at the same readout")
    if a.mirrored != b.mirrored:
        raise BadInput("one lens is mirrored and the other is not: no rotation brings them together",
                       mend="calibrate both on frames that are read out the same way")
    xy = _grid(a.image_size_px)
    inside = _inside(xy, a.image_size_px, fit_radius_px)
    v_a, v_b = projection.unproject(a, xy), projection.unproject(b, xy)
    turn = _best_rotation(b, v_a[inside], xy[inside])
    turned = v_a @ turn.T
    seen, by_v, by_b = projection.project_with_jacobian(b, turned)
    if not np.all(np.isfinite(seen)):
        raise BadInput("the second lens does not see all of the first one's field: its model folds inside the image",
                       mend="calibrate with views that reach the corners, or with fewer distortion terms")
    by_a = projection.project_with_jacobian(a, v_a)[2]
    by_turn = by_v @ -rotation.skew(turned)
    expected_px2 = _expected_px2(by_a, a, by_turn, inside) + _expected_px2(by_b, b, by_turn, inside)
    return LensDifference(xy_px=xy, shift_px=seen - xy, angle_rad=sphere.angle_between(turned, v_b),
                          expected_px=np.sqrt(expected_px2),
                          rotation_rad=rotation.rotvec_from_matrix(turn), inside=inside)


def _grid(image_size_px: tuple[int, int]) -> np.ndarray:
    """(N, 2) pixels, evenly from corner to corner."""
    w, h = image_size_px
    rows = max(2, round(GRID_COLUMNS * h / w))
    x, y = np.meshgrid(np.linspace(0, w - 1, GRID_COLUMNS), np.linspace(0, h - 1, rows))
    return np.column_stack([x.ravel(), y.ravel()])


def _inside(xy: np.ndarray, image_size_px: tuple[int, int], radius_px: float | None) -> np.ndarray:
    if radius_px is None:
        return np.ones(len(xy), bool)
    centre = (np.array(image_size_px) - 1) / 2
    inside = np.hypot(*(xy - centre).T) <= radius_px
    if np.count_nonzero(inside) < 3:
        raise BadInput(f"a region of {radius_px:g} px about the centre is too small to fit a rotation",
                       mend=f"give a radius of at least {2 * image_size_px[0] / GRID_COLUMNS:.0f} px")
    return inside


def _best_rotation(b: Intrinsics, v_a: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(3, 3) R that minimises |project_B(R v_a) - xy| in pixels. d(R v)/dr = -skew(R v) for a small turn r after R."""
    turn = np.eye(3)
    for _ in range(STEPS):
        turned = v_a @ turn.T
        seen, by_v, _ = projection.project_with_jacobian(b, turned)
        visible = np.isfinite(seen).all(axis=1)
        if np.count_nonzero(visible) < 3:
            break
        jacobian = (by_v @ -rotation.skew(turned))[visible].reshape(-1, 3)
        step = np.linalg.lstsq(jacobian, (xy - seen)[visible].ravel(), rcond=None)[0]
        turn = rotation.matrix_from_rotvec(step) @ turn
        if np.linalg.norm(step) < CONVERGED_RAD:
            return turn
    raise BadInput("the lenses are so different that no rotation brings them together",
                   mend="check that both are calibrations of the same camera, in the same units")


def _expected_px2(by_parameters: np.ndarray, lens: Intrinsics, by_turn: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """(N,) variance of the shift, both axes together, that one lens's covariance brings, without what a rotation absorbs."""
    if not np.all(np.isfinite(lens.covariance)):
        return np.full(len(by_parameters), np.inf)
    n = by_parameters.shape[-1]
    absorbed = np.linalg.lstsq(by_turn[inside].reshape(-1, 3), by_parameters[inside].reshape(-1, n), rcond=None)[0]
    left = by_parameters - by_turn @ absorbed
    return np.einsum("nip,pq,niq->n", left, lens.covariance, left)


def _size(lens: Intrinsics) -> str:
    return f"{lens.image_size_px[0]} x {lens.image_size_px[1]}"
