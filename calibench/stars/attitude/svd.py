"""Markley's SVD method (Markley 1988): B = U diag(s) V', R = U diag(1, 1, det U det V) V'. No eigenvalue is approximated."""

from __future__ import annotations

import numpy as np

from ...geometry.rotation import nearest_rotation
from ._davenport import effective_weights, profile_matrix

__all__ = ["attitude", "effective_weights"]


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    return nearest_rotation(profile_matrix(camera, sky, weights))
