"""Start values from views of a plane: homographies, focal lengths, poses; all views at once.

1. Homography of each view by linear least squares on normalised points (Hartley 1997), h33 = 1 at the board's middle.
2. Focal lengths from the orthogonality of its columns, principal point at the image's centre (Zhang 2000, sec. 3.1).
3. Pose of each view from the homography of its directions under the lens (Zhang 2000, sec. 3.1).
"""

from __future__ import annotations

import numpy as np

from ...errors import BadInput
from ...geometry import projection
from ...records import DISTORTION_NAMES, Intrinsics
from .boards import Boards

NO_FOCAL = "the views allow no focal length: all show the board at the same tilt"
LONGEST_FOCAL = 100.0  # image widths; beyond, rounding alone makes the focal length
LEAST_COSINE = 0.1
TILT = "tilt the board by 20 to 45 degrees about both axes, differently in each view"


def start(xy_px: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str, *,
          skew_free: bool = False) -> tuple[Intrinsics, Boards]:
    """Lens without distortion, and the boards before it.

    Args:
        xy_px: (V, P, 2), NaN where a point was not found. points_mm: (P, 3), a plane z = 0. skew_free: the lens has a skew.

    Raises:
        BadInput: the homographies allow no focal length.
    """
    centre = (np.array(image_size_px) - 1) / 2
    fx, fy = _focal_lengths(_homographies(xy_px - centre, points_mm), LONGEST_FOCAL * max(image_size_px))
    terms = len(DISTORTION_NAMES[model])
    lens = Intrinsics(model=model, fx_px=fx, fy_px=fy, cx_px=centre[0], cy_px=centre[1], distortion=np.zeros(terms),
                      image_size_px=image_size_px, covariance=np.full((4 + terms + skew_free,) * 2, np.inf),
                      skew_px=0.0 if skew_free else None)
    return lens, posed(lens, xy_px, points_mm)


def posed(lens: Intrinsics, xy_px: np.ndarray, points_mm: np.ndarray, **more: object) -> Boards:
    """Boards (V, P, 2) px at the poses that they have under a lens; `more`: further fields of Boards.

    Raises:
        BadInput: the lens has no direction for a point.
    """
    there = np.isfinite(xy_px).all(axis=-1)
    v = np.full((*there.shape, 3), np.nan)
    v[there] = projection.unproject(lens, xy_px[there])
    z = np.where(v[..., 2:] > LEAST_COSINE, v[..., 2:], np.nan)  # the rest of a fisheye's field has no place in a plane
    h = _homographies(v[..., :2] / z, points_mm)
    scale = 1 / np.sqrt(np.linalg.norm(h[:, :, 0], axis=1) * np.linalg.norm(h[:, :, 1], axis=1))
    h = h * scale[:, None, None]  # h33 > 0: the board's middle lies before the camera
    r1, r2, translation = np.moveaxis(h, 2, 0)
    u, _, wt = np.linalg.svd(np.stack([r1, r2, np.cross(r1, r2)], axis=-1))
    u[:, :, 2] *= np.linalg.det(u @ wt)[:, None]
    rotation = u @ wt
    middle = points_mm[:, :2].mean(axis=0)
    return Boards(xy_px=np.where(there[..., None], xy_px, 0.0), weight=there.astype(float), points_mm=points_mm,
                  rotation=rotation, translation_mm=translation - rotation[:, :, :2] @ middle, **more)


def _homographies(xy: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """(V, 3, 3) from board coordinates (mm, origin at the board's middle) to the plane of xy (V, P, 2); NaN: not there."""
    there = np.isfinite(xy).all(axis=-1)
    weight = there / there.sum(axis=1, keepdims=True)
    xy = np.where(there[..., None], xy, 0.0)
    at = (weight[..., None] * xy).sum(axis=1)
    spread = np.sqrt((weight * ((xy - at[:, None]) ** 2).sum(axis=-1)).sum(axis=1))
    board = points_mm[:, :2] - points_mm[:, :2].mean(axis=0)
    size = np.sqrt((board**2).sum(axis=1).mean())
    m = np.column_stack([board / size, np.ones(len(board))])
    products = (m[:, :, None] * m[:, None]).reshape(len(m), 9)
    x, y = np.moveaxis((xy - at[:, None]) / spread[:, None, None], -1, 0)
    moments = np.stack([weight, weight * x, weight * y, weight * (x * x + y * y)]) @ products
    one, of_x, of_y, of_square = moments.reshape(4, len(xy), 3, 3)
    normal = np.zeros((len(xy), 9, 9))
    normal[:, :3, :3] = normal[:, 3:6, 3:6] = one
    normal[:, :3, 6:], normal[:, 3:6, 6:], normal[:, 6:, 6:] = -of_x, -of_y, of_square
    normal[:, 6:, :3], normal[:, 6:, 3:6] = -of_x, -of_y
    h = np.ones((len(xy), 9))
    h[:, :8] = np.linalg.solve(normal[:, :8, :8], -normal[:, :8, 8:])[..., 0]
    h = h.reshape(-1, 3, 3) / [size, size, 1]
    h[:, :2] *= spread[:, None, None]
    h[:, :2] += at[:, :, None] * h[:, 2:]
    return h


def _focal_lengths(h: np.ndarray, longest_px: float) -> tuple[float, float]:
    """fx, fy from homographies into pixels about the principal point; one for both axes where two cannot be told apart."""
    h = h / np.sqrt(np.linalg.norm(h[:, :2, 0], axis=1) * np.linalg.norm(h[:, :2, 1], axis=1))[:, None, None]
    (a1, a2), (b1, b2), (c1, c2) = (np.moveaxis(h[:, i, :2], 1, 0) for i in range(3))
    left = np.concatenate([np.stack([a1 * a2, b1 * b2], -1), np.stack([a1**2 - a2**2, b1**2 - b2**2], -1)])
    right = -np.concatenate([c1 * c2, c1**2 - c2**2])
    inverse2 = np.linalg.lstsq(left, right, rcond=None)[0]
    if not (inverse2 > longest_px**-2).all():
        both = left.sum(axis=1)
        inverse2 = np.full(2, both @ right / (both @ both))
    if not (inverse2 > longest_px**-2).all():
        raise BadInput(NO_FOCAL, mend=TILT)
    fx, fy = 1 / np.sqrt(inverse2)
    return float(fx), float(fy)
