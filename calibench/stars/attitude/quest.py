"""QUEST (Shuster and Oh 1981), with the sequential rotations that keep it away from half turns.

    alpha = l^2 - sigma^2 + tr adj S, gamma = alpha (l + sigma) - det S, x = (alpha I + (l - sigma) S + S^2) z
    q = (x, gamma) / norm, l the largest root of psi (`_davenport.largest_root`)

gamma is proportional to the square of the quaternion's scalar part: at half turns it vanishes and x and gamma lose their
digits (the thesis loses 873 of 26437 exact cases so). Turning the sky by 180 deg about an axis first (sequential rotation)
leaves l unchanged and moves another component of the quaternion into the scalar's place: of the four frames (none, x, y, z)
the one with the largest gamma is used, and one of the four squares is always at least 1/4.
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

FLIPS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))  # diagonals: no turn, and half turns about x, y, z


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    l = largest_root(b)
    rows = b.tolist()
    flip = max(FLIPS, key=lambda diagonal: _gamma(l, rows, diagonal))
    turned = b * flip
    q = settled(k_matrix(turned), l, lambda root: _quaternion(root, turned.tolist()))
    return matrix_of_papers_quaternion(q) * flip


def _symmetric(b: list[list[float]], flip: tuple[int, int, int]) -> tuple[float, ...]:
    """sigma and the six parts of S = B + B' for the columns of B turned by a flip: sigma, s11, s22, s33, s12, s13, s23."""
    f1, f2, f3 = flip
    (b11, b12, b13), (b21, b22, b23), (b31, b32, b33) = b
    d1, d2, d3 = b11 * f1, b22 * f2, b33 * f3
    return (d1 + d2 + d3, 2 * d1, 2 * d2, 2 * d3, b12 * f2 + b21 * f1, b13 * f3 + b31 * f1, b23 * f3 + b32 * f2)


def _alpha_gamma(l: float, sigma: float, s11: float, s22: float, s33: float, s12: float, s13: float,
                 s23: float) -> tuple[float, float]:
    minors = s22 * s33 - s23 * s23 + s11 * s33 - s13 * s13 + s11 * s22 - s12 * s12
    determinant = s11 * (s22 * s33 - s23 * s23) - s12 * (s12 * s33 - s23 * s13) + s13 * (s12 * s23 - s22 * s13)
    alpha = l * l - sigma * sigma + minors
    return alpha, alpha * (l + sigma) - determinant


def _gamma(l: float, b: list[list[float]], flip: tuple[int, int, int]) -> float:
    return _alpha_gamma(l, *_symmetric(b, flip))[1]


def _quaternion(l: float, b: list[list[float]]) -> np.ndarray:
    """Unit quaternion (x, gamma) of the papers for the eigenvalue l."""
    sigma, s11, s22, s33, s12, s13, s23 = parts = _symmetric(b, FLIPS[0])
    alpha, gamma = _alpha_gamma(l, *parts)
    z1, z2, z3 = b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]
    y1, y2, y3 = (s11 * z1 + s12 * z2 + s13 * z3, s12 * z1 + s22 * z2 + s23 * z3, s13 * z1 + s23 * z2 + s33 * z3)
    r = l - sigma
    q = np.array([alpha * z1 + r * y1 + s11 * y1 + s12 * y2 + s13 * y3, alpha * z2 + r * y2 + s12 * y1 + s22 * y2 + s23 * y3,
                  alpha * z3 + r * y3 + s13 * y1 + s23 * y2 + s33 * y3, gamma])
    return q / np.sqrt(q @ q)
