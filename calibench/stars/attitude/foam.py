"""FOAM, the fast optimal attitude matrix (Markley 1993): no quaternion, no half turn that is special.

    R = [(kappa + |B|^2) B + l adj(B') - B B' B] / zeta, kappa = (l^2 - |B|^2) / 2, zeta = kappa l - det B
    l: the largest root of (l^2 - |B|^2)^2 - 8 l det B - 4 |adj B|^2 = 0, which is psi of QUEST in B's own terms

An l that is off leaves R off the rotations; R is brought back to the nearest one, whose trace with B is a better l
(second order, as in `_davenport.settled`).
"""

from __future__ import annotations

import numpy as np

from ...geometry.rotation import nearest_rotation
from ._davenport import SETTLED, SETTLING_STEPS, adjoint, effective_weights, profile_matrix
from .kernels import NEWTON_STEPS

__all__ = ["attitude", "effective_weights"]


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    minors = np.array(adjoint(b.tolist()))
    determinant, square = float(b[0] @ minors[:, 0]), float(np.vdot(b, b))
    l = _largest_root(square, determinant, float(np.vdot(minors, minors)))
    cube = b @ b.T @ b
    for _ in range(SETTLING_STEPS):
        kappa = (l * l - square) / 2
        matrix = nearest_rotation(((kappa + square) * b + l * minors.T - cube) / (kappa * l - determinant))
        before, l = l, float(np.vdot(matrix, b))
        if abs(l - before) <= SETTLED:
            break
    return matrix


def _largest_root(square: float, determinant: float, minors: float) -> float:
    """Newton from the sum of the weights (1), as in `kernels.largest_root`."""
    l = 1.0
    for _ in range(NEWTON_STEPS):
        rest = l * l - square
        slope = 4 * l * rest - 8 * determinant
        if slope <= 0:
            break
        step = (rest * rest - 8 * l * determinant - 4 * minors) / slope
        l -= step
        if abs(step) < SETTLED:
            break
    return l
