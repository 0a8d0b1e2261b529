"""ESOQ2 (Mortari 1997, 2000): Euler axis and angle from a 3 x 3 matrix.

(K - l I) q = 0 with q = (e sin, cos) leaves for the axis  M e = 0,  M = (sigma - l)(S - (l + sigma) I) - z z',  so that e is
the longest cross product of two columns of M, and q = ((l - sigma) e, z.e) / norm. Without a rotation M vanishes; the sky is
turned by half turns first (as in QUEST) and the frame with the largest rotation is used: the one with the smallest tr B.
"""

from __future__ import annotations

import numpy as np

from ._davenport import (
    effective_weights,
    k_matrix,
    k_parts,
    largest_root,
    matrix_of_papers_quaternion,
    profile_matrix,
    settled,
)
from .kernels import FLIPS

__all__ = ["attitude", "effective_weights"]


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    b11, b22, b33 = b[0, 0], b[1, 1], b[2, 2]
    flip = min(FLIPS, key=lambda f: f[0] * b11 + f[1] * b22 + f[2] * b33)
    turned = b * flip
    s, z, sigma = k_parts(turned)

    def quaternion_at(l: float) -> np.ndarray:
        (a, b, c), (_, d, e), (_, _, f) = ((sigma - l) * (s - (l + sigma) * np.eye(3)) - np.outer(z, z)).tolist()
        # Columns of the adjugate of a symmetric matrix of rank two: all along e, the longest by its diagonal element.
        columns = ((d * f - e * e, c * e - b * f, b * e - c * d), (c * e - b * f, a * f - c * c, b * c - a * e),
                   (b * e - c * d, b * c - a * e, a * d - b * b))
        axis = np.array(columns[max(range(3), key=lambda i: abs(columns[i][i]))])
        q = np.append((l - sigma) * axis, z @ axis)
        return q / np.sqrt(q @ q)
    q = settled(k_matrix(turned), largest_root(b), quaternion_at)
    return matrix_of_papers_quaternion(q) * flip
