"""How uncertain the direction is that a pixel sees, with the camera's turn that fits best taken out.

A lens's error moves all directions together, as a turn of the camera would, and apart. An attitude fitted to stars takes up
the turn; what remains is what the lens's error does to angles. With parameters p, directions u_i(p) and a turn d:
    du_i = (du/dxy)(-dxy/dp) dp - d x u_i,   d = the least-squares turn over the pixels given.
"""

from __future__ import annotations

import numpy as np

from ..records import Intrinsics
from . import projection, rotation


def direction_jacobian(intrinsics: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) of pixels (N, 2), and their change with the lens parameters (N, 3, P), best common turn removed.

    Raises:
        BadInput: a pixel has no direction under this lens.
    """
    v, by_xy = projection.unproject_with_jacobian(intrinsics, xy_px)
    _, _, by_parameters = projection.project_with_jacobian(intrinsics, v)
    moved = -by_xy @ by_parameters
    by_turn = -rotation.skew(v)  # a turn d moves v by d x v
    turn = np.linalg.lstsq(by_turn.reshape(-1, 3), moved.reshape(len(v) * 3, -1), rcond=None)[0]
    return v, moved - by_turn @ turn


def direction_covariance(intrinsics: Intrinsics, xy_px: np.ndarray) -> np.ndarray:
    """Covariance (N, 3, 3), rad^2 in camera axes, of the directions seen by pixels (N, 2): the field over which the best turn
    is taken out is these pixels, so give a grid over the image.

    Raises:
        BadInput: a pixel has no direction under this lens.
    """
    _, jacobian = direction_jacobian(intrinsics, xy_px)
    return jacobian @ intrinsics.covariance @ np.swapaxes(jacobian, 1, 2)
