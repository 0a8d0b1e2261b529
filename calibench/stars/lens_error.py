"""What the lens's own uncertainty does to an attitude: a bias common to all frames of one map, kept apart from the random part.

Linear propagation through the fit. With residuals r = xy - project(R v; p), rotation step d (R -> exp([d]x) R), Jacobians
J_d and J_p, weights W:   d = -(sum J_d' W J_d)^-1 (sum J_d' W J_p) dp  =  G dp.
The image's centre sees the direction u(p) = unproject(centre; p), which moves by (du/dxy)(-dxy/dp) dp; on the sky, in camera
axes, the two together move it by  u_p dp - d x u.
"""

from __future__ import annotations

import numpy as np

from ..geometry import projection, rotation
from ..records import Identification, Intrinsics
from .per_lens import per_lens


def systematic(found: Identification, matrix: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Attitude covariance (3, 3), rad^2 in camera axes, and the 1-sigma error, rad rms per axis, of the image's centre.

    weight: (M, 2, 2) as in the attitude's fit. Parameters of infinite variance (not known at all) make both infinite.
    """
    lens = found.intrinsics
    if not np.isfinite(lens.covariance).all():
        return np.full((3, 3), np.inf), float("inf")
    predicted = found.direction_icrs @ matrix.T
    _, by_v, by_p = projection.project_with_jacobian(lens, predicted)
    by_d = by_v @ -rotation.skew(predicted)
    weighted = np.swapaxes(by_d, 1, 2) @ weight
    gain = -np.linalg.solve((weighted @ by_d).sum(0), (weighted @ by_p).sum(0))
    u, centre_by_p = _centre(lens)
    moved = centre_by_p + rotation.skew(u) @ gain
    return gain @ lens.covariance @ gain.T, float(np.sqrt(max(np.trace(moved @ lens.covariance @ moved.T), 0) / 2))


@per_lens
def _centre(lens: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Direction (3,) of the image's centre, and how it moves with the lens's parameters (3, P)."""
    w, h = lens.image_size_px
    u, by_xy = projection.unproject_with_jacobian(lens, np.array([[(w - 1) / 2, (h - 1) / 2]]))
    _, _, by_p = projection.project_with_jacobian(lens, u)
    return u[0], -by_xy[0] @ by_p[0]
