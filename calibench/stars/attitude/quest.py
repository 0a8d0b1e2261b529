"""QUEST (Shuster and Oh 1981), with the sequential rotations that keep it away from half turns.

    psi(l) = l^4 - (a + b) l^2 - c l + (a b + c sigma - d) = 0, Newton from l = 1 (the sum of the weights)
    a = sigma^2 - tr adj S, b = sigma^2 + z.z, c = det S + z.S z, d = z.S^2 z
    alpha = l^2 - sigma^2 + tr adj S, gamma = alpha (l + sigma) - det S, x = (alpha I + (l - sigma) S + S^2) z
    q = (x, gamma) / norm

gamma is proportional to the square of the quaternion's scalar part: at half turns it vanishes and x and gamma lose their
digits (the thesis loses 873 of 26437 exact cases so). Turning the sky by 180 deg about an axis first (sequential rotation)
leaves l unchanged and moves another component of the quaternion into the scalar's place: of the four frames (none, x, y, z)
the one with the largest gamma is used, and one of the four squares is always at least 1/4.
Newton's step is checked against psi; where it has not converged (few, noisy stars: a nearly double root) the largest
eigenvalue of K is computed instead.
"""

from __future__ import annotations

import numpy as np

from ._davenport import k_parts, matrix_of_papers_quaternion, profile_matrix

NEWTON_STEPS = 20
FLIPS = (np.diag([1.0, 1, 1]), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]))


def largest_root(s: np.ndarray, z: np.ndarray, sigma: float) -> float:
    """The largest root of psi by Newton from 1; the exact eigenvalue where Newton does not settle."""
    adjoint = (np.trace(s) ** 2 - np.trace(s @ s)) / 2  # tr adj S, safe for singular S
    a, b = sigma**2 - adjoint, sigma**2 + z @ z
    c, d = np.linalg.det(s) + z @ s @ z, z @ s @ s @ z
    l = 1.0
    for _ in range(NEWTON_STEPS):
        psi = l**4 - (a + b) * l**2 - c * l + (a * b + c * sigma - d)
        slope = 4 * l**3 - 2 * (a + b) * l - c
        if slope <= 1e-7:  # right of the largest root psi rises; a flat or falling curve means a double root nearby
            break
        step = psi / slope
        l -= step
        if abs(step) < 1e-15:
            return l
    k = np.block([[s - sigma * np.eye(3), z[:, None]], [z[None, :], np.array([[sigma]])]])
    return float(np.linalg.eigvalsh(k)[-1])


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    l = largest_root(*k_parts(b))
    frames = [(flip, *_vector_and_gamma(l, *k_parts(b @ flip))) for flip in FLIPS]
    flip, x, gamma = max(frames, key=lambda frame: frame[2])
    return matrix_of_papers_quaternion(np.append(x, gamma)) @ flip


def _vector_and_gamma(l: float, s: np.ndarray, z: np.ndarray, sigma: float) -> tuple[np.ndarray, float]:
    """Unnormalised quaternion (x, gamma) of one frame."""
    adjoint = (np.trace(s) ** 2 - np.trace(s @ s)) / 2
    alpha = l * l - sigma * sigma + adjoint
    gamma = alpha * (l + sigma) - np.linalg.det(s)
    return (alpha * np.eye(3) + (l - sigma) * s + s @ s) @ z, float(gamma)
