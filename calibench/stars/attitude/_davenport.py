"""Davenport's matrix K, shared by the quaternion methods (Davenport 1968; Shuster and Oh 1981)."""

from __future__ import annotations

import numpy as np

from ...errors import BadInput

LEAST_SPREAD = 1e-10  # second singular value of B over the first: below it all vectors are one line


def profile_matrix(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """B = sum of a_i b_i r_i^T (3, 3), b camera, r sky, weights scaled to sum 1.

    Raises:
        BadInput: fewer than two directions, or all (nearly) parallel: the attitude is not observable.
    """
    if len(camera) < 2:
        raise BadInput(f"{len(camera)} direction gives no attitude: at least two are needed")
    w = np.asarray(weights, float) / np.sum(weights)
    b = (camera * w[:, None]).T @ sky
    singular = np.linalg.svd(b, compute_uv=False)
    if singular[1] < LEAST_SPREAD * singular[0]:
        raise BadInput("all directions are parallel: rotation about them is not observable")
    return b


def k_parts(b: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """S = B + B^T, z = (B23 - B32, B31 - B13, B12 - B21), sigma = tr B (the thesis prints z's first term wrong)."""
    return b + b.T, np.array([b[1, 2] - b[2, 1], b[2, 0] - b[0, 2], b[0, 1] - b[1, 0]]), float(np.trace(b))


def matrix_of_papers_quaternion(q: np.ndarray) -> np.ndarray:
    """Attitude matrix of the papers' (x, y, z, w): A = (w^2 - x.x) I + 2 x x^T - 2 w [x]x, which maps sky to camera."""
    x, w = q[:3] / np.linalg.norm(q), q[3] / np.linalg.norm(q)
    cross = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
    return (w * w - x @ x) * np.eye(3) + 2 * np.outer(x, x) - 2 * w * cross
