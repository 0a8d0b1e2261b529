"""What the quaternion methods share (Davenport 1968; Shuster and Oh 1981): B, K, and the largest root of K's polynomial.

K = [[S - sigma I, z], [z', sigma]] with S = B + B', sigma = tr B, z = (B23 - B32, B31 - B13, B12 - B21). The optimal
quaternion is K's eigenvector of the largest eigenvalue. The fast methods take that eigenvalue from the characteristic
polynomial, which for stars within an angle t of each other is only good to 1e-16 / t^2, and hand the quaternion an error of
1e-16 / t^4. A Rayleigh quotient is second order in that error, so one or two of them (`settled`) bring back what double
precision allows, 1e-16 / t^2.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import BadInput
from .kernels import largest_root

LEAST_SPREAD = 1e-10  # second singular value of B over the first: below it all vectors are one line
SETTLING_STEPS = 4
SETTLED = 1e-15

__all__ = ["adjoint", "effective_weights", "k_matrix", "k_parts", "largest_root", "matrix_of_papers_quaternion",
           "profile_matrix", "settled"]


def profile_matrix(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """B = sum of a_i b_i r_i^T (3, 3), b camera, r sky, weights scaled to sum 1.

    Raises:
        BadInput: fewer than two directions, all (nearly) on one line, or weights and directions that are no numbers: the
            attitude is not observable.
    """
    if len(camera) < 2:
        raise BadInput(f"{len(camera)} direction gives no attitude: at least two are needed")
    total = weights.sum()
    if not total > 0 or weights.min() < 0:
        raise BadInput("weights are no finite numbers, or a weight is negative, or all are zero")
    b = (camera * (weights / total)[:, None]).T @ sky
    square = float(np.vdot(b, b))
    # |adj B| is s1 s2 to within a factor of sqrt(3), s being the singular values: no decomposition is needed to see a line.
    minors = np.array(adjoint(b.tolist()))
    spread = float(np.sqrt(np.vdot(minors, minors))) / square
    if not np.isfinite(spread):
        raise BadInput("directions are no finite numbers")
    if spread < LEAST_SPREAD:
        raise BadInput("all directions are parallel: rotation about them is not observable")
    return b


def effective_weights(camera: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Every star counts as it was weighted: the form for methods that solve Wahba's problem."""
    return weights


def adjoint(m: list[list[float]]) -> list[list[float]]:
    """Adjugate (transposed cofactors) of a 3 x 3 list: m adj(m) = det(m) I."""
    (a, b, c), (d, e, f), (g, h, i) = m
    return [[e * i - f * h, c * h - b * i, b * f - c * e],
            [f * g - d * i, a * i - c * g, c * d - a * f],
            [d * h - e * g, b * g - a * h, a * e - b * d]]


def k_parts(b: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """S = B + B^T, z = (B23 - B32, B31 - B13, B12 - B21), sigma = tr B (the thesis prints z's first term wrong)."""
    return b + b.T, np.array([b[1, 2] - b[2, 1], b[2, 0] - b[0, 2], b[0, 1] - b[1, 0]]), float(np.trace(b))


def k_matrix(b: np.ndarray) -> np.ndarray:
    """K (4, 4), scalar part last."""
    (b11, b12, b13), (b21, b22, b23), (b31, b32, b33) = b.tolist()
    s12, s13, s23 = b12 + b21, b13 + b31, b23 + b32
    z1, z2, z3 = b23 - b32, b31 - b13, b12 - b21
    return np.array([[b11 - b22 - b33, s12, s13, z1], [s12, b22 - b11 - b33, s23, z2], [s13, s23, b33 - b11 - b22, z3],
                     [z1, z2, z3, b11 + b22 + b33]])


def settled(k: np.ndarray, l: float, quaternion_at: Callable[[float], np.ndarray]) -> np.ndarray:
    """The quaternion whose Rayleigh quotient is the eigenvalue that it was made with; by eigenvectors where none is found.

    quaternion_at: the method's unit quaternion for an eigenvalue; not finite where the method cannot say.
    """
    for _ in range(SETTLING_STEPS):
        q = quaternion_at(l)
        better = float(q @ (k @ q))
        if abs(better - l) <= SETTLED:
            return q
        l = better
    return np.linalg.eigh(k)[1][:, -1]


def matrix_of_papers_quaternion(q: np.ndarray) -> np.ndarray:
    """Attitude matrix of the papers' (x, y, z, w): A = (w^2 - x.x) I + 2 x x^T - 2 w [x]x, which maps sky to camera."""
    x, y, z, w = (q / np.sqrt(q @ q)).tolist()
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
                     [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
                     [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]])
