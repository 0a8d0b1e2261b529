"""Davenport's q-method: the eigenvector of K with the largest eigenvalue. Slower than QUEST, never in trouble."""

from __future__ import annotations

import numpy as np

from ._davenport import effective_weights, k_matrix, matrix_of_papers_quaternion, profile_matrix

__all__ = ["attitude", "effective_weights"]


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    _, vectors = np.linalg.eigh(k_matrix(profile_matrix(camera, sky, weights)))
    return matrix_of_papers_quaternion(vectors[:, -1])
