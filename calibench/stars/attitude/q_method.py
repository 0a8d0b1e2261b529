"""Davenport's q-method: the eigenvector of K with the largest eigenvalue. Slower than QUEST, never in trouble."""

from __future__ import annotations

import numpy as np

from ._davenport import k_parts, matrix_of_papers_quaternion, profile_matrix


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    s, z, sigma = k_parts(profile_matrix(camera, sky, weights))
    k = np.block([[s - sigma * np.eye(3), z[:, None]], [z[None, :], np.array([[sigma]])]])
    _, vectors = np.linalg.eigh(k)
    return matrix_of_papers_quaternion(vectors[:, -1])
