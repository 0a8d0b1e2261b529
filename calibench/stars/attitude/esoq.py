"""ESOQ, the estimator of the optimal quaternion (Mortari 1997).

The quaternion is the cross product, in four dimensions, of three rows of K - l I. All its cross products are columns of the
adjugate; the one with the largest diagonal element keeps its digits, so that no rotation is special.
"""

from __future__ import annotations

import numpy as np

from ._davenport import (
    effective_weights,
    k_matrix,
    largest_root,
    matrix_of_papers_quaternion,
    profile_matrix,
    settled,
)

__all__ = ["attitude", "effective_weights"]

OTHERS = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    k = k_matrix(b)
    return matrix_of_papers_quaternion(settled(k, largest_root(b), lambda l: _cross_product(k, l)))


def _cross_product(k: np.ndarray, l: float) -> np.ndarray:
    """Unit vector orthogonal to three rows of K - l I, leaving out the row that makes it longest."""
    h = k.tolist()
    for i in range(4):
        h[i][i] -= l
    best = max(range(4), key=lambda i: abs(_minor(h, i, i)))
    q = np.array([(-1) ** (best + j) * _minor(h, best, j) for j in range(4)])
    return q / np.sqrt(q @ q)


def _minor(h: list[list[float]], row: int, column: int) -> float:
    """Determinant of h without a row and a column."""
    (a, b, c), (d, e, f), (g, i, j) = ([h[r][m] for m in OTHERS[column]] for r in OTHERS[row])
    return a * (e * j - f * i) - b * (d * j - f * g) + c * (d * i - e * g)
